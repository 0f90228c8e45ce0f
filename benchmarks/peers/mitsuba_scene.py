# SPDX-License-Identifier: Apache-2.0
"""The scenes of `scenes.py` as scenes of the path tracer Mitsuba 3 (Jakob et al. 2022).

The light is the sky above the horizon and, as a disc far away, the sun. The floor is a square of 1 km; what lies below
the horizon beyond it has the radiance that the endless floor has. The variant is scalar_rgb, which needs no compiler on
the machine. Metal is Mitsuba's `principled` of metallic 1: GGX of alpha = roughness^2 and Schlick's Fresnel, as ours,
but without the light that bounces between microfacets.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import Any

import numpy as np

from benchmarks.peers.scenes import FLOOR_ALBEDO, FLOOR_Y_M, PAVING_CONTRAST, Scene, Sky
from mr360uw.base.sphere import directions
from mr360uw.composite import PlacedObject
from mr360uw.types import Floats

WINDOW = (1800, 1350)
"""Columns and rows of the picture: about 300 of its pixels fall into one of the frame."""
_FLOOR_HALF_M, _SUN_M = 500.0, 1e5
_SKY_COLUMNS = 1024


def has_mitsuba() -> bool:
    """Return whether the path tracer is installed; where it is missing, say what to install."""
    found = importlib.util.find_spec("mitsuba") is not None
    if not found:
        print("left out: mitsuba is not installed (pip install 'mr360uw[peers]')")
    return found


def mitsuba() -> Any:
    """Return the path tracer; where it is missing, leave the program, which has not failed."""
    if not has_mitsuba():
        sys.exit(0)
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    return mi


def _rgb(values: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in np.broadcast_to(values, 3)]}


def _bsdf(body: PlacedObject) -> dict[str, Any]:
    (material,) = body.mesh.materials
    color = _rgb(material.base_color[:3])
    if material.metallic == 1.0:
        return {"type": "principled", "base_color": color, "metallic": 1.0, "roughness": material.roughness}
    assert (material.refractive_index, material.metallic) == (1.0, 0.0), "a material that has no twin in Mitsuba"
    surface = {"type": "diffuse", "reflectance": color}
    return {"type": "twosided", "bsdf": surface} if material.double_sided else surface


def _shape(mi: Any, name: str, body: PlacedObject) -> Any:
    """Return a body's triangles with their own normals."""
    corners = body.to_world(body.mesh.positions).reshape(-1, 3)
    normals = (body.mesh.normals @ body.world_from_object[:3, :3].T).reshape(-1, 3)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(body))
    mesh = mi.Mesh(name, len(corners), len(corners) // 3, has_vertex_normals=True, props=properties)
    values = mi.traverse(mesh)
    values["vertex_positions"] = corners.astype(np.float32).ravel()
    values["vertex_normals"] = normals.astype(np.float32).ravel()
    values["faces"] = np.arange(len(corners), dtype=np.uint32)
    values.update()
    return mesh


def surroundings(sky: Sky) -> Floats:
    """Return the light around a scene, an equirectangular frame (H, W, 3) float32: the sky, below it the far floor."""
    around = directions(_SKY_COLUMNS, _SKY_COLUMNS // 2)
    return np.where(around[..., 1:2] > 0.0, sky.radiance(around), sky.floor_radiance).astype(np.float32)


def _environment(mi: Any, sky: Sky) -> dict[str, Any]:
    """Return the sky as an emitter. Mitsuba's column 0 looks along -z, which is the middle of ours."""
    image = np.roll(surroundings(sky), _SKY_COLUMNS // 2, axis=1)
    return {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image))}


def _sun(mi: Any, sky: Sky) -> dict[str, Any]:
    """Return the sun as a disc that faces the scene: E = pi L sin^2 of its half angle."""
    assert sky.sun is not None
    radiance = sky.sun.irradiance / (np.pi * np.sin(sky.sun.half_angle_rad) ** 2)
    place = mi.ScalarTransform4f().look_at(
        origin=(_SUN_M * sky.sun.direction).tolist(), target=[0.0, 0.0, 0.0], up=[0.0, 0.0, 1.0]
    )
    return {
        "type": "disk",
        "to_world": place.scale(_SUN_M * float(np.tan(sky.sun.half_angle_rad))),
        "emitter": {"type": "area", "radiance": _rgb(radiance)},
    }


def _floor(mi: Any, paving_m: float) -> dict[str, Any]:
    """Return the floor's albedo. Its middle, u = v = 1/2, is a corner of four slabs; u goes along x, v along -z."""
    if paving_m == 0.0:
        return _rgb(FLOOR_ALBEDO)
    first, second = (_rgb(FLOOR_ALBEDO * (1.0 + way * PAVING_CONTRAST)) for way in (1.0, -1.0))
    cells = mi.ScalarTransform3f().scale(_FLOOR_HALF_M / paving_m)  # one cell of the texture is two slabs wide
    return {"type": "checkerboard", "color0": first, "color1": second, "to_uv": cells}


def build(
    mi: Any,
    scene: Scene,
    sky: Sky,
    *,
    bodies: bool = True,
    ambient: bool = True,
    window: tuple[int, int] = WINDOW,
) -> Any:
    """Return Mitsuba's scene; on request without its bodies, or with the sun alone. window: size of the picture."""
    transform = mi.ScalarTransform4f
    width, height = window
    film = {
        "type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "component_format": "float32",
        "rfilter": {"type": "box"},
    }  # fmt: skip
    described: dict[str, Any] = {
        "type": "scene",
        "floor": {
            "type": "rectangle",
            "to_world": transform().translate([0.0, FLOOR_Y_M, 0.0]).rotate([1, 0, 0], -90).scale(_FLOOR_HALF_M),
            "bsdf": {"type": "diffuse", "reflectance": _floor(mi, scene.paving_m)},
        },
        "sensor": {
            "type": "perspective", "fov": scene.fov_deg, "film": film, "sampler": {"type": "independent"},
            "to_world": transform().look_at(origin=[0, 0, 0], target=list(scene.look_at), up=[0, 1, 0]),
        },
    }  # fmt: skip
    if ambient:
        described["sky"] = _environment(mi, sky)
    if sky.sun is not None:
        described["sun"] = _sun(mi, sky)
    if bodies:
        described |= {f"body{k}": _shape(mi, f"body{k}", body) for k, body in enumerate(scene.bodies)}
    return mi.load_dict(described)
