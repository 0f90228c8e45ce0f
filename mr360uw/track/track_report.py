# SPDX-License-Identifier: Apache-2.0
"""The reports of a solved camera and of a floor in plain words."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mr360uw.track.camera_track import CameraTrack
from mr360uw.track.floor_mesh import FloorMesh
from mr360uw.track.structure import WIDTH

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


_DISTANCE_M = 5.0
"""Distance [m] of an object whose slip is told."""
_GOOD_PX, _USABLE_PX = 0.6, 1.2
"""Largest median residual [px] of a good and of a usable track. Below, codec noise; above, features slip."""
_GOOD_SHARE, _USABLE_SHARE = 0.9, 0.6
"""Least share of frames that were solved rather than interpolated."""
_FAR = 50.0
"""Largest extent of a path over the median distance of its points; a wrong pose reaches thousands."""
_KINDS = {"still": "stands still", "turning": "turns on the spot", "moving": "moves"}


def verdict(track: CameraTrack) -> str:
    """Return one line that says how good a track is."""
    solved = np.isfinite(track.residual_px)
    share, residual = float(np.mean(solved)), float(np.nanmedian(track.residual_px))
    word = "doubtful"
    if residual <= _USABLE_PX and share >= _USABLE_SHARE:
        word = "usable"
    if residual <= _GOOD_PX and share >= _GOOD_SHARE:
        word = "good"
    if len(track.points) and np.ptp(track.position, axis=0).max() > _FAR * np.median(
        np.linalg.norm(track.points - track.position[0], axis=1)
    ):
        word = "doubtful"  # a path that leaves its own points behind
    slip_m = _DISTANCE_M * float(np.radians(np.nanmedian(track.residual_deg)))
    return (
        f"{word}: objects stay in place to {100.0 * slip_m:.1f} cm at {_DISTANCE_M:g} m; "
        f"{np.count_nonzero(solved)} of {len(solved)} frames solved; residual {residual:.2f} px"
    )


def report_lines(track: CameraTrack) -> list[str]:
    """Return the printed report: what the camera does, the verdict, up, scale, floor."""
    lines = [f"the camera {_KINDS[track.kind]}"]
    if np.isfinite(track.residual_px).any():
        lines.append(verdict(track))
    if track.kind == "moving":
        length = float(np.linalg.norm(np.diff(track.position, axis=0), axis=1).sum())
        lines.append(
            f"path      {length:.2f} m in {track.time_s[-1] - track.time_s[0]:.1f} s"
            + (
                f"; {len(track.points)} points; features over {100.0 * track.coverage:.0f} % of the sphere"
                if len(track.points)
                else ""
            )
        )
    if track.held_out_px is not None:
        ground = ""
        if track.slip_px is not None:
            ground = f"the ground slips by {track.slip_px:.2f} px (worst key frame {track.worst_slip_px:.2f}), "
        lines.append(
            f"held out  {ground}single features by {track.held_out_px:.2f} px, in key frames that did not place them; "
            f"px of a panorama {WIDTH} wide"
        )
    lines += [f"up        {track.up}", f"scale     {track.scale}"]
    if track.depth_m is not None:
        lines.append(f"depth     [camera] depth_m = {track.depth_m:.2f}")
    if track.floor is not None:
        floor = track.floor
        lines.append(
            f"floor     [receiver] height_m = {floor.height_m:.2f}   # tilt {floor.tilt_deg:.1f} degrees; "
            f"{floor.points} points, {100.0 * floor.support:.0f} % of those below the camera"
        )
    return lines
