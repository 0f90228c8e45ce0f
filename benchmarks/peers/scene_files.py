# SPDX-License-Identifier: Apache-2.0
"""The scenes of `scenes.py` as the files that a user would have, and their composites by the program's defaults.

A folder holds the plates (`KINDS`) and the meshes. The tables of a scene file name them, and say that there is no
water, how high the camera is over the floor, and what the meshes are made of. Nothing else is set; where the light is
told, the place of the sun is, and of a plate that clips it the sun's share of the light.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.scenes import FLOOR_Y_M, Scene, Sky
from mr360uw.base.color import encode, luminance
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.composite import PlacedObject
from mr360uw.ibl.lookup import reduce_map
from mr360uw.runs.pipeline import composite_video
from mr360uw.scene.model import scene_from_dict
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Floats
from mr360uw.video.exr import write_exr

KINDS = {"float": "exr", "8 bit": "png"}
"""Plates: linear floats without a limit, and sRGB codes that end at 1, as a camera has them."""
_EXPOSURE = {"exr": 1.0, "png": 0.5}
"""Of these plates: a camera takes a mean of a quarter of white, and clips the sun alone."""
WHITE = {"float": np.inf, "8 bit": 0.8 / _EXPOSURE["png"]}
"""Radiance that they can show, as a mean over some pixels."""
FINER = 4
"""Columns of the plate for one of the truth's: the sun's disc is two pixels wide."""


def write_files(scene: Scene, sky: Sky, folder: Path, width: int) -> None:
    """Write both plates, some columns wide, and the meshes of a scene into a folder."""
    import cv2
    import trimesh

    plate = scene.plate(sky, width)
    write_exr(folder / "plate.exr", plate)
    codes = np.round(255.0 * encode(np.clip(_EXPOSURE["png"] * plate, 0.0, 1.0), "srgb")).astype(np.uint8)
    cv2.imwrite(str(folder / "plate.png"), codes[..., ::-1])
    for k, body in enumerate(scene.bodies):
        points, normals = (a.reshape(-1, 3) for a in (body.mesh.positions, body.mesh.normals))
        faces = np.arange(len(points)).reshape(-1, 3)
        mesh = trimesh.Trimesh(points, faces, vertex_normals=normals, process=False)
        mesh.export(folder / f"body{k}.glb", include_normals=True)


def tables(scene: Scene, sky: Sky, kind: str, *, told: bool) -> dict[str, Any]:
    """Return the scene file's tables for a kind of plate."""
    found: dict[str, Any] = {
        "plate": f"plate.{KINDS[kind]}",
        "water": {"type": "none"},
        "object": [_object(k, body) for k, body in enumerate(scene.bodies)],
        "receiver": {"height_m": FLOOR_Y_M},
    }
    if told:
        found["light"] = {"sun": "none"} if sky.sun is None else _told(sky, kind)
    return found


def _object(number: int, body: PlacedObject) -> dict[str, Any]:
    (material,) = body.mesh.materials
    return {
        "mesh": f"body{number}.glb", "position_m": body.world_from_object[:3, 3].tolist(),
        "base_color": list(material.base_color[:3]), "metallic": material.metallic, "roughness": material.roughness,
        "refractive_index": material.refractive_index, "double_sided": material.double_sided,
    }  # fmt: skip


def _told(sky: Sky, kind: str) -> dict[str, Any]:
    assert sky.sun is not None
    x, y, z = sky.sun.direction
    told = {
        "sun": "given",
        "sun_azimuth_deg": float(np.degrees(np.arctan2(x, -z))),
        "sun_elevation_deg": float(np.degrees(np.arcsin(y))),
    }
    if kind == "8 bit":
        around = directions(512, 256)[:128]
        received = around[..., 1] * row_solid_angle(512, 256)[:128, None]
        of_sky = np.tensordot(received, sky.radiance(around), 2)
        told["direct_to_diffuse"] = float(luminance(sky.sun.irradiance) * y / luminance(of_sky))
    return told


def composited(folder: Path, data: dict[str, Any], backend: str, width: int) -> Floats:
    """Return the composite (H, W, 3) of tables of a scene file, as it is written, reduced to a number of columns and
    of an exposure of 1.
    """
    scene = scene_from_dict(data, folder)
    out = folder / f"out{Path(scene.plate.path).suffix}"
    composite_video(scene, out, backend=backend, overwrite=True, fresh=True)
    with open_plate(scene_from_dict({**data, "plate": out.name}, folder)) as video:
        (frame,) = video.frames(0, 1)
    return reduce_map(frame.image_linear, width, width // 2) / _EXPOSURE[out.suffix[1:]]
