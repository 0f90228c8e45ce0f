# SPDX-License-Identifier: Apache-2.0
"""Small scenes that several tests share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.base.sphere import directions
from mr360uw.scene.model import Scene, scene_from_dict

BACKENDS = ("reference", "gl")


def gradient_plate(width: int, height: int, sun: tuple[float, float, float] | None = (0.3, 0.9, -0.2)) -> np.ndarray:
    """Return a plate (H, W, 3) that looks like water: blue, brighter towards the surface, with a clipped sun."""
    d = directions(width, height)
    up = 0.5 + 0.5 * d[..., 1:2]
    image = np.array([0.02, 0.10, 0.16]) + up**2 * np.array([0.08, 0.28, 0.34])
    if sun is not None:
        s = np.asarray(sun) / np.linalg.norm(sun)
        image = image + 3.0 * np.exp((d @ s - 1.0) / 0.004)[..., None]
    return np.clip(image, 0.0, 1.0).astype(np.float32)


def scene_with(folder: Path, mesh: Path | None, *, rough: bool = False, **tables: Any) -> Scene:
    """Return a scene of a plate that is not read, with `mesh` in front of the camera unless None.

    Its water has few wavelengths, unless a table says how many: it is solved in a fifth of the time. rough: whether the
    light about the sun is computed roughly, which halves the time of a frame's light.
    """
    plate = folder / "plate.png"
    if not plate.exists():
        plate.touch()
    data: dict[str, Any] = {"plate": str(plate)} | tables
    data["water"] = {"bands": 8} | ({"rough": True} if rough else {}) | data.get("water", {})
    if mesh is not None and "object" not in data:
        data["object"] = [{"mesh": str(mesh), "position_m": [0.3, -0.4, -3.0], "rotation_deg": [-60.0, 5.0, 0.0]}]
    return scene_from_dict(data, folder)


def yawed(data: list[dict[str, Any]], yaw_deg: float) -> list[dict[str, Any]]:
    """Return object tables turned about the camera's vertical axis, to the right for positive angles."""
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    turned = []
    for table in data:
        x, y, z = table["position_m"]
        rotation = table.get("rotation_deg", [0.0, 0.0, 0.0])
        turned.append(
            {**table, "position_m": [c * x - s * z, y, s * x + c * z],
             "rotation_deg": [rotation[0] + yaw_deg, *rotation[1:]]}
        )  # fmt: skip
    return turned
