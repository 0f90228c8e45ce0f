# SPDX-License-Identifier: Apache-2.0
"""The solved path of a camera: poses, scene points, floor, residuals; written as CSV and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.output_gate import check_outputs
from mr360uw.shapes import checked
from mr360uw.types import Floats

Kind = Literal["still", "turning", "moving"]
"""The camera stands still, turns on the spot, or moves."""
SUFFIXES = (".csv", ".json")


@dataclass(frozen=True, slots=True)
class FittedFloor:
    """Plane fitted to the points below the camera.

    height_m: of the plane at the first camera's position, negative. tilt_deg: between its normal and up. support: share
    (0 to 1) of the points below the camera that lie on the plane. points: their number.
    """

    height_m: float
    tilt_deg: float
    support: float
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class CameraTrack:
    """Path of a camera in the world of its first frame: +y up, the first camera at the origin, looking towards -z.

    kind: whether the camera stands still, turns on the spot, or moves. time_s (n,). position (n, 3) [m], as far as the
    scale is known. rotation (n, 3, 3): rotates camera axes (right, up, back) to the world's. residual_px,
    residual_deg (n,): median distance between observed and predicted features of a frame, in pixels of a frame of
    `width` columns and degrees; NaN where a frame was interpolated. key_frames (k,): frames that COLMAP or the matches
    solved. points (m, 3) [m], point_error_px (m,): scene points and their mean reprojection errors. coverage: share of
    the sphere of directions with features, 0 to 1. up, scale: sentences that say where they are from. slip_px,
    worst_slip_px: median and largest slip of the ground over key frames, held_out_px: median error of single features,
    as `structure` defines them, in pixels of a panorama 2048 wide. depth_m: of the first camera, of a depth log.
    """

    kind: Kind
    time_s: Floats
    position: Floats
    rotation: Floats
    residual_px: Floats
    residual_deg: Floats
    key_frames: np.ndarray
    points: Floats
    point_error_px: Floats
    coverage: float
    width: int
    floor: FittedFloor | None
    up: str
    scale: str
    slip_px: float | None = None
    worst_slip_px: float | None = None
    held_out_px: float | None = None
    depth_m: float | None = None

    @property
    def quaternion(self) -> Floats:
        """Rotations as quaternions (n, 4), x, y, z, w, without jumps of sign."""
        from scipy.spatial.transform import Rotation

        found = Rotation.from_matrix(self.rotation).as_quat()
        signs = np.where(np.sum(found[1:] * found[:-1], axis=1) < 0.0, -1.0, 1.0)
        return np.asarray(found * np.concatenate([[1.0], np.cumprod(signs)])[:, None])

    def csv(self) -> str:
        """Return the table that `camera.track` of a scene reads: time_s, x, y, z, qx, qy, qz, qw."""
        rows = np.column_stack([self.time_s, self.position, self.quaternion])
        lines = (",".join(f"{value:.9g}" for value in row) for row in rows)
        return "\n".join(["time_s,x,y,z,qx,qy,qz,qw", *lines, ""])

    def json(self) -> str:
        """Return everything as JSON; residuals of interpolated frames are null."""
        return json.dumps({
            "format": "mr360uw camera track 1", "kind": self.kind, "up": self.up, "scale": self.scale,
            "coverage": round(self.coverage, 4), "width": self.width, "slip_px": self.slip_px,
            "worst_slip_px": self.worst_slip_px, "held_out_px": self.held_out_px, "depth_m": self.depth_m,
            "key_frames": self.key_frames.tolist(),
            "floor": None if self.floor is None else asdict(self.floor),
            "time_s": self.time_s.tolist(), "position_m": self.position.tolist(),
            "quaternion_xyzw": self.quaternion.tolist(), "residual_px": _nullable(self.residual_px),
            "residual_deg": _nullable(self.residual_deg), "points_m": self.points.round(5).tolist(),
            "point_error_px": self.point_error_px.round(4).tolist(),
        })  # fmt: skip

    @checked
    def save(self, out: str | Path, *, overwrite: bool = False) -> tuple[Path, Path]:
        """Write the table (.csv) and everything (.json) beside each other; return both paths.

        out: the name of either. Raises `ParameterError` or `OutputExistsError`.
        """
        paths = track_files(out, overwrite=overwrite)
        for path, text in zip(paths, (self.csv(), self.json()), strict=True):
            write_whole(path, text)
        return paths


def track_files(out: str | Path, inputs: Iterable[Path] = (), *, overwrite: bool) -> tuple[Path, Path]:
    """Return the paths of the table and of the JSON for the name of either.

    inputs: files that were read for them. Raises `ParameterError`, or `OutputError` where they may not be written.
    """
    out = Path(out)
    if out.suffix.lower() not in SUFFIXES:
        raise ParameterError(
            f"{out} - is no name of a track (got {out.suffix!r}) - end it in .csv or .json (with --from: .chan, .py)"
        )
    paths = out.with_suffix(".csv"), out.with_suffix(".json")
    check_outputs(paths, inputs=inputs, overwrite=overwrite)
    return paths


def shot_path(out: Path, number: int) -> Path:
    """Return the name of the track of a shot, counted from 1, of a clip with cuts."""
    return out.with_name(f"{out.stem}.shot{number}{out.suffix}")


def _nullable(values: Floats) -> list[float | None]:
    return [round(float(v), 5) if np.isfinite(v) else None for v in values]
