# SPDX-License-Identifier: Apache-2.0
"""Reads and writes sun tracks as one table, JSON (columns) or CSV (a line a frame), to plot and edit.

Angles are in degrees, in level axes: azimuth 0 = centre of the frame, + = right; elevation + = up. An empty cell (null)
means that there is no sun. Editing `azimuth_deg`, `elevation_deg` or `irradiance_*` changes what is rendered; the
`raw_` columns are the measurements, for comparison.
"""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.ibl.sun.track import SunTrack
from mr360uw.output_gate import check_outputs
from mr360uw.reading.input_files import json_of, read_text
from mr360uw.shapes import checked
from mr360uw.sphere import direction_from_angles

Array = NDArray[np.float64]

_FORMAT = "mr360uw sun track 1"
_LIGHT = ("red", "green", "blue")
COLUMNS = (
    "frame", "shot", "time_s", "azimuth_deg", "elevation_deg", *(f"irradiance_{c}" for c in _LIGHT), "half_angle_deg",
    "confidence", "raw_azimuth_deg", "raw_elevation_deg", *(f"raw_irradiance_{c}" for c in _LIGHT), "raw_confidence",
    "exposure", "share",
)  # fmt: skip


def _angles(direction: Array) -> tuple[Array, Array]:
    azimuth = np.degrees(np.arctan2(direction[:, 0], -direction[:, 2]))
    elevation = np.degrees(np.arctan2(direction[:, 1], np.hypot(direction[:, 0], direction[:, 2])))
    return azimuth, elevation


def track_table(track: SunTrack) -> dict[str, list[float | None]]:
    """Return the columns of a track, rounded to 1e-6, None where there is no sun."""
    frame = np.arange(len(track))
    columns = (
        frame, np.searchsorted(np.asarray(track.cuts), frame, side="right"), track.times_s, *_angles(track.direction),
        *track.irradiance.T, np.degrees(track.half_angle_rad), track.confidence, *_angles(track.raw_direction),
        *track.raw_irradiance.T, track.raw_confidence, track.exposure, track.share,
    )  # fmt: skip
    return {
        name: [round(float(v), 6) if math.isfinite(v) else None for v in column]
        for name, column in zip(COLUMNS, columns, strict=True)
    }


@checked
def save_track(track: SunTrack, path: str | Path) -> None:
    """Write a track to a file whose name ends in .json or .csv."""
    path = Path(path)
    table = track_table(track)
    if path.suffix == ".json":
        text = json.dumps({"format": _FORMAT, "columns": table}, indent=1)
    elif path.suffix == ".csv":
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(zip(*table.values(), strict=True))
        text = out.getvalue()
    else:
        raise ParameterError(f"{path} - not a name for a track (got {path.suffix!r}) - end it in .json or .csv")
    check_outputs([path], overwrite=True)
    write_whole(path, text + "\n" if path.suffix == ".json" else text)


@checked
def load_track(path: str | Path) -> SunTrack:
    """Return a track from a .json or .csv file that `save_track` wrote, edited or not."""
    path = Path(path)
    text = read_text(path, ParameterError)
    try:
        if path.suffix == ".csv":
            rows = list(csv.DictReader(io.StringIO(text)))
            table = {name: [row[name] for row in rows] for name in (rows[0] if rows else COLUMNS)}
        else:
            table = json_of(text)["columns"]
        whole = {"share": [1.0] * len(table["frame"])}  # earlier files have none
        data = {n: np.array([np.nan if v in (None, "") else float(v) for v in (whole | table)[n]]) for n in COLUMNS}
    except (KeyError, TypeError, ValueError, OverflowError, csv.Error) as error:
        raise ParameterError(
            f"{path} - not a readable sun track (got: {error!s:.120}) - write it with save_track"
        ) from error
    if not len(data["frame"]) or any(len(column) != len(data["frame"]) for column in data.values()):
        raise ParameterError(f"{path} - columns of unequal length or empty - write it with save_track")

    def directions(prefix: str) -> Array:
        pairs = zip(np.radians(data[f"{prefix}azimuth_deg"]), np.radians(data[f"{prefix}elevation_deg"]), strict=True)
        return np.stack([direction_from_angles(azimuth, elevation) for azimuth, elevation in pairs])

    return SunTrack(
        times_s=data["time_s"],
        raw_direction=directions("raw_"),
        direction=directions(""),
        raw_irradiance=np.stack([data[f"raw_irradiance_{c}"] for c in _LIGHT], axis=1),
        irradiance=np.stack([data[f"irradiance_{c}"] for c in _LIGHT], axis=1),
        half_angle_rad=np.radians(data["half_angle_deg"]),
        raw_confidence=np.nan_to_num(data["raw_confidence"]),
        confidence=np.nan_to_num(data["confidence"]),
        exposure=data["exposure"],
        share=np.nan_to_num(data["share"], nan=1.0),
        cuts=tuple(int(k) + 1 for k in np.flatnonzero(np.diff(data["shot"]) > 0)),
    )
