# SPDX-License-Identifier: Apache-2.0
"""Materials of glTF 2.0 (section 3.9 of its specification) and of the extensions that `gltf.FOLLOWED` lists."""

from __future__ import annotations

import math
from typing import Any

from mr360uw.composite.mesh.gltf import Gltf
from mr360uw.composite.mesh.material import MAPS, MapCoordinates, MappedMaterial, Material
from mr360uw.composite.mesh.texture import Pixels, Texture, Wrap, decode_image, make_texture
from mr360uw.errors import MeshError

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}


_PLAIN = MapCoordinates("TEXCOORD_0")
BARE = MappedMaterial(Material(base_color=(1.0, 1.0, 1.0, 1.0), roughness=1.0, double_sided=True), (_PLAIN,))
"""Default material: glTF's white, but not metallic, and drawn on both sides."""


class MaterialReader:
    """Reads the materials of a file; one image is decoded once for each use, and maps of one image are one texture."""

    def __init__(self, gltf: Gltf) -> None:
        self.gltf = gltf
        self.notes: list[str] = []
        self._pixels: dict[int, Pixels] = {}
        self._textures: dict[tuple[int, bool, tuple[Wrap, Wrap]], Texture] = {}

    def read(self, number: int) -> MappedMaterial:
        """Return a material of the file's list."""
        entry = self.gltf.entry("materials", number)
        extensions = entry.get("extensions", {})
        name = str(entry.get("name", number))
        pbr = entry.get("pbrMetallicRoughness", {})
        if "KHR_materials_pbrSpecularGlossiness" in extensions:
            pbr = self._from_glossiness(name, extensions["KHR_materials_pbrSpecularGlossiness"])
        metallic = float(pbr.get("metallicFactor", 1.0))
        if "KHR_materials_unlit" in extensions:
            metallic = float(pbr.get("metallicFactor", 0.0))
            self._note(f"material {name!r} is unlit (KHR_materials_unlit) - the scene lights its colours")
        if "emissiveTexture" in entry and not any(entry.get("emissiveFactor", ())):
            self._note(
                f"material {name!r} has a map of emission and the factor 0 - it does not glow; export the factor"
            )
        references = {
            "base_map": pbr.get("baseColorTexture"),
            "metallic_roughness_map": pbr.get("metallicRoughnessTexture"),
            "normal_map": entry.get("normalTexture"),
            "occlusion_map": entry.get("occlusionTexture"),
            "emission_map": entry.get("emissiveTexture") if any(entry.get("emissiveFactor", ())) else None,
        }
        maps, coordinates = self._maps({slot: r for slot, r in references.items() if r is not None})
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        red, green, blue = (strength * float(c) for c in entry.get("emissiveFactor", (0.0, 0.0, 0.0)))
        r, g, b, a = (float(c) for c in pbr.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0)))
        mode = entry.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise ValueError(f"alphaMode {mode!r}")
        material = Material(
            name=name,
            base_color=(r, g, b, a),
            metallic=metallic,
            roughness=float(pbr.get("roughnessFactor", 1.0)),
            emission=(red, green, blue),
            normal_scale=float((references["normal_map"] or {}).get("scale", 1.0)),
            occlusion_strength=float((references["occlusion_map"] or {}).get("strength", 1.0)),
            alpha_mode=mode,
            alpha_cutoff=float(entry.get("alphaCutoff", 0.5)),
            double_sided=bool(entry.get("doubleSided", False)),
            refractive_index=_index(extensions),
            **maps,
        )
        self._check(material, coordinates)
        return MappedMaterial(material, coordinates)

    def _check(self, material: Material, coordinates: tuple[MapCoordinates, ...]) -> None:
        """Raise `MeshError` where a factor is not finite, or one of light or reflection is negative."""
        placed = [n for one in coordinates for n in (*one.offset, *one.scale, one.rotation_rad)]
        if bad := [*material.wrong_factors, *(factor for factor in placed if not math.isfinite(factor))]:
            raise MeshError(
                f"{self.gltf.path} - material {material.name!r} has a factor that is negative or not finite (got "
                f"{bad[0]:g}) - correct the material"
            )

    def _from_glossiness(self, name: str, entry: dict[str, Any]) -> dict[str, Any]:
        """Return the diffuse half of KHR_materials_pbrSpecularGlossiness as a dielectric."""
        self._note(f"material {name!r} is given by specular and glossiness - its specular colours are not drawn")
        return {
            "baseColorFactor": entry.get("diffuseFactor", (1.0, 1.0, 1.0, 1.0)),
            "baseColorTexture": entry.get("diffuseTexture"),
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0 - float(entry.get("glossinessFactor", 1.0)),
        }

    def _maps(self, references: dict[str, dict[str, Any]]) -> tuple[dict[str, Any], tuple[MapCoordinates, ...]]:
        """Return the maps by slot, with the `sets` of their texture coordinates, and these, each once."""
        own = {slot: _coordinates(reference) for slot, reference in references.items()}
        each = tuple(dict.fromkeys(own.values())) or (_PLAIN,)
        maps: dict[str, Any] = {
            slot: self._texture(reference["index"], srgb=slot in ("base_map", "emission_map"))
            for slot, reference in references.items()
        }
        return maps | {"sets": tuple(each.index(own[slot]) if slot in own else 0 for slot in MAPS)}, each

    def _texture(self, number: int, *, srgb: bool) -> Texture:
        entry = self.gltf.entry("textures", number)
        source = entry.get("extensions", {}).get("EXT_texture_webp", {}).get("source", entry.get("source"))
        if source is None:
            raise MeshError(f"{self.gltf.path} - texture {number} is of a kind that is not read - export PNG or JPEG")
        sampler = self.gltf.entry("samplers", entry["sampler"]) if "sampler" in entry else {}
        wrap = _WRAPS[sampler.get("wrapS", 10497)], _WRAPS[sampler.get("wrapT", 10497)]
        key = (source, srgb, wrap)
        if key not in self._textures:
            if source not in self._pixels:
                self._pixels[source] = decode_image(self.gltf.image(source), f"{self.gltf.path} image {source}")
            self._textures[key] = make_texture(self._pixels[source], srgb=srgb, wrap=wrap)
        return self._textures[key]

    def _note(self, text: str) -> None:
        note = f"{self.gltf.path} - {text}"
        if note not in self.notes:
            self.notes.append(note)


def _coordinates(reference: dict[str, Any]) -> MapCoordinates:
    """Return a set of coordinates and its KHR_texture_transform.

    The signs are those of the extension's own example; those of its first shader text turn the other way.
    """
    entry = reference.get("extensions", {}).get("KHR_texture_transform", {})
    (x, y), (sx, sy) = entry.get("offset", (0.0, 0.0)), entry.get("scale", (1.0, 1.0))
    texcoord = int(entry.get("texCoord", reference.get("texCoord", 0)))
    turn = float(entry.get("rotation", 0.0))
    return MapCoordinates(f"TEXCOORD_{texcoord}", (float(x), float(y)), turn, (float(sx), float(sy)))


def _index(extensions: dict[str, Any]) -> float:
    """Return the refractive index; 0, a perfect mirror in the extension, becomes a very large index."""
    index = float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5))
    return index if index > 0.0 else 1e3
