# SPDX-License-Identifier: Apache-2.0
"""Materials of glTF files on both renderers, against closed forms: normal maps, mirrors, cut-outs, occlusion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.base.cache import shared
from mr360uw.base.sphere import unit
from mr360uw.composite import load_mesh
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.mesh.material import Material, make_texture
from mr360uw.composite.reference import render_aovs
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.types import Layer, Sun
from tests.composite import tolerances as tol
from tests.composite.gltf_files import GltfFile
from tests.composite.scenes import environment, placed, quad, shot, sphere


def draw(backend: str, scene: Shot) -> tuple[Layer, Aovs]:
    """Return the layer and its output variables by one of the renderers."""
    return render_aovs(scene) if backend == "reference" else gl_renderer().layer(scene, variables=True)


@shared(keep=1)
def gl_renderer() -> LayerRenderer:
    """One for the file: it keeps its shaders."""
    return LayerRenderer()


def in_front(path: Path, **more: Any) -> Shot:
    """Return a shot of a mesh in x, y in [0, 1] that fills the middle of the frame."""
    transform = np.eye(4)
    transform[:3, 3] = -0.5, -0.5, -1.0
    return shot(PlacedObject(load_mesh(path, "m"), transform), width=32, sun=None, **more)


def bumped_square(
    path: Path, code: tuple[int, int, int], *, swap: bool = False, node: dict[str, Any] | None = None
) -> Path:
    """Write a square whose normal map is one colour; swap: with its image mirrored from left to right."""
    file = GltfFile()
    texture = {"index": file.texture(np.full((4, 4, 3), code, np.uint8))}
    file.tree["materials"] = [{"normalTexture": texture, "doubleSided": True}]
    square = file.square(material=0)
    if swap:
        square["attributes"]["TEXCOORD_0"] = file.accessor([[1, 1], [0, 1], [0, 0], [1, 0]])
    file.mesh(square)
    file.tree["nodes"] = [{"mesh": 0, **(node or {})}]
    return file.write(path)


MIDDLE = (8, 16)
RIGHT, UP = (230, 128, 230), (128, 230, 230)
"""Codes of normals that lean to the right and up the image."""
LEAN = unit([2 * 230 / 255 - 1, 2 * 128 / 255 - 1, 2 * 230 / 255 - 1])
TURN = [0.0, 1.0, 0.0, 0.0]
"""Half a turn about +y."""


@pytest.mark.parametrize(
    ("code", "swap", "node", "expected"),
    [
        (RIGHT, False, {}, LEAN),
        (UP, False, {}, LEAN[[1, 0, 2]]),
        # a mirrored image leans the other way, up stays up
        (RIGHT, True, {}, LEAN * [-1, 1, 1]),
        (UP, True, {}, LEAN[[1, 0, 2]] * [-1, 1, 1]),
        # so does a mirrored node: what it shows is its mirror image
        (RIGHT, False, {"scale": [-1, 1, 1], "translation": [1, 0, 0]}, LEAN * [-1, 1, 1]),
        (UP, False, {"scale": [1, -1, 1], "translation": [0, 1, 0]}, LEAN[[1, 0, 2]] * [1, -1, 1]),
        # seen from behind, the whole frame of the map is turned round (glTF 2.0 section 3.9.7)
        (RIGHT, False, {"rotation": TURN, "translation": [1, 0, 0]}, LEAN * [1, -1, 1]),
    ],
)  # fmt: skip
def test_normal_maps_lean_as_painted(
    tmp_path: Path, backend: str, code: tuple[int, int, int], swap: bool, node: dict[str, Any], expected: np.ndarray
) -> None:
    path = bumped_square(tmp_path / "bump.glb", code, swap=swap, node=node)
    _, variables = draw(backend, in_front(path))
    np.testing.assert_allclose(variables.normal[MIDDLE], expected, atol=tol.HALF_FLOAT)


def test_normal_maps_under_an_uneven_scale_keep_right_angles(tmp_path: Path, backend: str) -> None:
    """A slope z = x stretched to z = x/2: its normal follows the inverse transpose, (-1, 0, 2) and not (-2, 0, 1)."""
    file = GltfFile(materials=[{}])
    corners = np.array([[0, 0, 0], [1, 0, 1], [1, 1, 1], [0, 1, 0]], float)
    attributes = {"POSITION": file.accessor(corners), "NORMAL": file.accessor(np.tile(unit([-1, 0, 1]), (4, 1)))}
    file.mesh({"attributes": attributes, "indices": file.accessor([0, 1, 2, 0, 2, 3], "u2"), "material": 0})
    file.tree["nodes"] = [{"mesh": 0, "scale": [1.0, 1.0, 0.5], "translation": [0, 0, -0.5]}]
    _, variables = draw(backend, in_front(file.write(tmp_path / "slope.glb")))
    np.testing.assert_allclose(variables.normal[MIDDLE], unit([-1, 0, 2]), atol=tol.HALF_FLOAT)


@pytest.mark.parametrize("cutoff", [0.25, 0.5, 0.75])
def test_masks_cut_where_alpha_crosses(backend: str, cutoff: float) -> None:
    """Alpha rises evenly from left to right: of the square, the part with alpha >= cutoff is left."""
    ramp = np.full((256, 256, 4), 255, np.uint8)
    ramp[..., 3] = np.arange(256)
    material = Material(
        alpha_mode="MASK", alpha_cutoff=cutoff, base_map=make_texture(ramp, srgb=True), double_sided=True
    )
    covered = [
        draw(backend, shot(placed(quad(m), (0.0, 0.0, -1.0)), width=128, sun=None))[0].alpha[32].sum()
        for m in (material, replace(material, alpha_mode="OPAQUE"))
    ]
    # pixels are even in longitude, and x = tan(longitude) on the square, which spans half its size to both sides
    left = np.arctan(cutoff - 0.5) / np.arctan(0.5)
    assert covered[0] == pytest.approx(0.5 * (1.0 - left) * covered[1], abs=tol.MASK_EDGE_PX)


def test_occlusion_darkens_ambient_light_alone(backend: str) -> None:
    """Red 51 of 255 at strength 0.5 leaves 1 + 0.5 (0.2 - 1) = 0.6 of the ambient light, and all of the sun's."""
    grey = make_texture(np.full((4, 4, 3), (51, 255, 255), np.uint8), srgb=False)
    plain = Material(base_color=(0.5, 0.5, 0.5, 1.0), roughness=0.6, double_sided=True)
    sun = Sun(unit([0.2, 0.5, 1.0]), np.ones(3), 0.01, 1.0)
    got = [
        draw(backend, shot(placed(quad(m), (0, 0, -1)), width=32, environment=environment(0.5), sun=sun))[1]
        for m in (plain, replace(plain, occlusion_map=grey, occlusion_strength=0.5))
    ]
    for name, factor in (("diffuse", 0.6), ("glossy", 0.6), ("sun", 1.0)):
        before, after = (getattr(v, name)[MIDDLE] for v in got)
        np.testing.assert_allclose(after, factor * before, rtol=tol.HALF_FLOAT)


_HALVES = {
    "baseColorTexture": ((90, 200, 40), (250, 60, 160)),
    "metallicRoughnessTexture": ((255, 40, 0), (255, 200, 230)),
    "normalTexture": ((128, 128, 255), (180, 90, 230)),
    "occlusionTexture": ((255, 0, 0), (80, 0, 0)),
    "emissiveTexture": ((0, 0, 0), (200, 120, 90)),
}
"""Colours of the left and of the right half of every map."""


def test_every_map_has_coordinates_of_its_own(tmp_path: Path, backend: str) -> None:
    """Each map shows its right half alone, by a set or a transform that no other has: as if it were of one colour."""
    pictures = []
    for halves in (False, True):
        file = GltfFile(extensionsUsed=["KHR_texture_transform"])
        square, references = file.square(material=0), {}
        corners = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], float)
        for number, (name, (left, right)) in enumerate(_HALVES.items()):
            image = np.full((8, 64, 3), right, np.uint8)
            place: dict[str, Any] = {}
            if halves and number % 2:  # a set
                image[:, :32] = left
                square["attributes"][f"TEXCOORD_{number}"] = file.accessor(
                    corners * [0.2, 1] + [0.6 + 0.02 * number, 0]
                )
                place = {"texCoord": number}
            elif halves:  # a transform
                image[:, :32] = left
                moved = {"offset": [0.6 + 0.02 * number, 0.0], "scale": [0.2, 1.0]}
                place = {"extensions": {"KHR_texture_transform": moved}}
            references[name] = {"index": file.texture(image), **place}
        names = ("baseColorTexture", "metallicRoughnessTexture")
        pbr = {name: references.pop(name) for name in names}
        file.tree["materials"] = [{"pbrMetallicRoughness": pbr, "emissiveFactor": [1, 1, 1], **references}]
        file.mesh(square)
        scene = in_front(file.write(tmp_path / "maps.glb"))
        pictures.append(draw(backend, replace(scene, lights=(Sun(unit([0.2, 0.5, 1.0]), np.ones(3), 0.01, 1.0),)))[1])
    baked, own = pictures
    for name in ("diffuse", "glossy", "sun", "emission", "normal"):
        np.testing.assert_allclose(getattr(own, name), getattr(baked, name), atol=tol.HALF_FLOAT)
    assert baked.emission[MIDDLE][0] > 0.1


def test_vertex_colours_blend(tmp_path: Path, backend: str) -> None:
    """A square of vertex colour (.8, .4, .2, .25), matt, in even light: alpha is .25, the rest multiplies."""
    file = GltfFile()
    square = file.square(material=0)
    square["attributes"]["COLOR_0"] = file.accessor([[0.8, 0.4, 0.2, 0.25]] * 4)
    factors = {"metallicFactor": 0.0, "baseColorFactor": [0.5, 1.0, 1.0, 1.0]}
    file.tree["materials"] = [{"alphaMode": "BLEND", "pbrMetallicRoughness": factors}]
    file.mesh(square)
    layer, variables = draw(backend, in_front(file.write(tmp_path / "c.glb"), environment=environment(1.0)))
    assert layer.alpha[MIDDLE] == pytest.approx(0.25, abs=tol.HALF_FLOAT)
    red, green, blue = variables.diffuse[MIDDLE]
    np.testing.assert_allclose([green / red, blue / red], [1.0, 0.5], rtol=tol.HALF_FLOAT)


def test_emission_is_what_the_file_says_whatever_the_light(tmp_path: Path, backend: str) -> None:
    file = GltfFile(extensionsUsed=["KHR_materials_emissive_strength"])
    texture = {"index": file.texture(np.full((4, 4, 3), 188, np.uint8))}
    file.tree["materials"] = [
        {
            "emissiveFactor": [1.0, 0.5, 0.25],
            "emissiveTexture": texture,
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8.0}},
        }
    ]
    file.mesh(file.square(material=0))
    _, variables = draw(backend, in_front(file.write(tmp_path / "glow.glb")))
    half = ((188 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(variables.emission[MIDDLE], 8.0 * half * np.array([1.0, 0.5, 0.25]), rtol=tol.HALF_FLOAT)


def test_a_smooth_ball_keeps_its_normals_when_it_is_placed(backend: str) -> None:
    ball = placed(sphere(64), (0.0, 0.0, -1.2), (30, 40, 50), scale=0.7)
    _, variables = draw(backend, shot(ball, width=32, sun=None))
    outwards = unit(variables.position[MIDDLE] - [0.0, 0.0, -1.2])
    np.testing.assert_allclose(variables.normal[MIDDLE], outwards, atol=tol.SMOOTH_NORMALS)
