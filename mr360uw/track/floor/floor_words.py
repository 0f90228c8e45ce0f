# SPDX-License-Identifier: Apache-2.0
"""The report of a floor in plain words."""

from __future__ import annotations

from pathlib import Path

from mr360uw.track.floor.floor_mesh import FloorMesh

_LEVEL_DEG = 1.0
"""Tilt [degrees] below which a flat floor may be taken for level: 5 cm over 3 m."""


def floor_lines(floor: FloorMesh, track: Path, mesh: Path) -> list[str]:
    """Return the printed report of a floor: its shape, how far it is known, and the lines of a scene that use it."""
    shape = "a plane" if floor.flat else "a relief"
    lines = [
        f"floor     {shape}, tilt {floor.tilt_deg:.1f} degrees, the camera {floor.camera_m:.2f} m above it",
        f"points    {floor.points}, {100.0 * floor.outliers:.0f} % of them left out; the others are within "
        f"{100.0 * floor.spread_m:.1f} cm of it",
        f"known     {floor.known_m2:.0f} square metres; beyond, it runs out into a plane",
        f'scene     [receiver] kind = "mesh", path = "{mesh.name}"   # with camera.track = "{track.stem}.csv"',
    ]
    if floor.flat and floor.tilt_deg < _LEVEL_DEG:
        lines.append(f'          or kind = "plane", height_m = {floor.plane_y_m:.2f}: it is level')
    return lines
