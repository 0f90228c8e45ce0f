# SPDX-License-Identifier: Apache-2.0
"""Scenes of any size: balls of any number and fineness before a dive of any width."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import mr360uw as uw
from benchmarks.cost.frame_cost import Subject
from mr360uw.scene.model import Scene, scene_from_dict

_FRAMES = 4
"""Frames of the clips: as many plates as take turns."""
_MADE_AT = 1024
"""Columns of the dive that clips of every width are scaled from."""
_RATE = 24
_DEPTH_M, _FLOOR_M = 6.0, -3.5
_FAR_M = 3.0
"""Distance [m] of the balls."""
_RADIUS_M = 0.5
"""Radius [m] of the ball that comes nearer."""
_COVERED = 0.01
"""Fraction of the sphere that balls cover in all, however many."""
_TRIANGLES = 1000

Tables = dict[str, Any]


class Dives:
    """Clips of one sample dive in a folder, by width, made when they are asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def plate(self, width: int, frames: int = _FRAMES) -> Path:
        """Return a clip of `frames` frames, `width` columns wide."""
        path = self.folder / f"dive-{width}-{frames}.mp4"
        if not path.exists():
            made = self.folder / "made" / "dive.mp4"
            if not made.exists():
                uw.sample_dive(made.parent, width=_MADE_AT, frames=_FRAMES)
            _scaled(made, path, width, frames)
        return path

    def scene(self, width: int, tables: Tables, frames: int = _FRAMES) -> Scene:
        """Return a scene with objects and other tables over a clip."""
        usual: Tables = {
            "camera": {"depth_m": _DEPTH_M},
            "light": {"sun": "given", "sun_azimuth_deg": 40.0, "sun_elevation_deg": 60.0},
            "water": {"type": "IB"},
            "plate": self.plate(width, frames).name,
        }
        return scene_from_dict(usual | tables, self.folder)

    def subject(self, width: int, tables: Tables) -> Subject:
        """Return a scene ready to draw frames."""
        return Subject(self.scene(width, tables))


def one_ball(folder: Path, triangles: int) -> Tables:
    """Return a ball of about so many triangles above the sea floor."""
    return balls(folder, 1, triangles)


def balls(folder: Path, count: int, triangles: int = _TRIANGLES) -> Tables:
    """Return balls all round the camera, above the sea floor, that cover a hundredth of the sphere in all."""
    mesh, radius = ball_file(folder, triangles), _FAR_M * _sine(_COVERED / count)
    placed = []
    for k in range(count):
        turn, height = 2.0 * math.pi * k / count, 0.6 * math.sin(2.4 * k)
        at = [_FAR_M * math.sin(turn), height, -_FAR_M * math.cos(turn)]
        placed.append(_moving(mesh, radius, at))
    return {"object": placed, "receiver": {"height_m": _FLOOR_M}}


def filling_ball(folder: Path, share: float) -> Tables:
    """Return a ball that covers a fraction of the sphere, up to a half, and nothing that catches its shadow.

    It comes nearer to cover more: its depths, and so the caustics that light it, stay the same.
    """
    return {"object": [_moving(ball_file(folder, _TRIANGLES), _RADIUS_M, [0.0, 0.0, -_RADIUS_M / _sine(share)])]}


def ball_file(folder: Path, triangles: int) -> Path:
    """Return a file of a ball of radius 1 m of about so many triangles."""
    path = folder / f"ball-{triangles}.glb"
    if not path.exists():
        import trimesh

        rows = max(round(math.sqrt(triangles / 4.0)), 4)
        mesh = trimesh.creation.uv_sphere(1.0, count=[rows, 2 * rows])
        path.write_bytes(trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh)))
    return path


def _sine(share: float) -> float:
    """Return the sine of the half angle of a cone that covers a fraction of the sphere."""
    return math.sqrt(1.0 - (1.0 - 2.0 * share) ** 2)


def _moving(mesh: Path, radius_m: float, at_m: list[float]) -> Tables:
    """Return a ball that moves by a tenth of a degree in each frame: its layer is not kept, its tiles hardly change."""
    step = 0.0017 * _FAR_M * _RATE
    after = [at_m[0], at_m[1] + step, at_m[2]]
    keys = [{"time_s": 0.0, "position_m": at_m}, {"time_s": 1.0, "position_m": after}]
    return {"mesh": mesh.name, "scale": radius_m, "position_m": at_m, "key": keys}


def _scaled(source: Path, target: Path, width: int, frames: int) -> None:
    """Write a clip at another width, over and over up to a number of frames."""
    import av

    with av.open(str(source)) as given:
        pictures = [frame.reformat(width, width // 2, "yuv420p") for frame in given.decode(video=0)]
    with av.open(str(target), "w") as made:
        stream = made.add_stream("libx264", rate=_RATE, options={"preset": "ultrafast", "crf": "18"})
        stream.width, stream.height, stream.pix_fmt = width, width // 2, "yuv420p"
        for k in range(frames):
            picture = pictures[k % len(pictures)]
            picture.pts, picture.pict_type, picture.time_base = k, 0, Fraction(1, _RATE)
            made.mux(stream.encode(picture))
        made.mux(stream.encode(None))
