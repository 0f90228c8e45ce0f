# SPDX-License-Identifier: Apache-2.0
"""Files of distance maps: those of `mr360uw depth`, and maps made elsewhere, as EXR or 16-bit PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.depth.warping import Map
from mr360uw.errors import VideoError
from mr360uw.reading.cached_reads import CachedReads
from mr360uw.video import read_picture
from mr360uw.video.exr import read_exr, read_rgb, write_exr

Kind = Literal["metric", "inverse"]
NOTE = "depth.json"
"""File in a folder of maps that says what they were made from."""

LEFT, RIGHT = "left", "right"
"""Parts of a file with the maps of both eyes."""
CONFIDENCE = "confidence"
"""Channel of a map's confidences, 0 to 1; a map without one is taken to be right everywhere."""
_SUFFIXES = (".exr", ".png")
_APART = 4
"""Maps that are kept: renderers may be some frames apart."""


def depth_file(folder: Path, index: int) -> Path:
    """Return the name of the map of a frame."""
    return folder / f"depth_{index:05d}.exr"


def write_depth(path: Path, found: DepthMap, right: DepthMap | None = None) -> None:
    """Write a map as EXR: distances [m] in the channel Z, infinite where unknown, and confidences.

    right: of the right eye of a stereo plate, in a part of its own; the other is then the left eye's.
    """
    parts = {"": found} if right is None else {LEFT: found, RIGHT: right}
    channels: dict[str, dict[str, NDArray[Any]]] = {
        name: {"Z": one.distance_m, CONFIDENCE: one.confidence.astype(np.float16)} for name, one in parts.items()
    }
    write_exr(path, channels)


class DepthClip:
    """Maps of a plate's frames in a folder: those of `mr360uw depth`, or others, the k-th by name for frame k.

    kind: "metric" for distances, "inverse" for their inverse, in files of other programs. scale_m: metres for the value
    1; of PNG files 1 is white. Raises `VideoError`.
    """

    def __init__(self, folder: Path, kind: Kind = "metric", scale_m: float = 1.0) -> None:
        self._folder, self._kind, self._scale = folder, kind, scale_m
        self._files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
        if not self._files:
            raise VideoError(f"{folder} - holds no maps (got no .exr and no .png) - run mr360uw depth into it")
        self._ours = (folder / NOTE).is_file()
        self._read = CachedReads()

    def check(self, stop: int) -> None:
        """Raise `VideoError` if a map is missing up to the plate's frame `stop`."""
        for index in range(stop):
            self._file(index)

    @property
    def of_both_eyes(self) -> bool:
        """Whether the first map has a part for each eye."""
        return self._ours and RIGHT in read_exr(self._files[0])

    def at(self, index: int, *, right: bool = False) -> DepthMap:
        """Return the map of a frame at its own size, the same object while its file is unchanged.

        right: that of the right eye, of files that hold both eyes'.
        """
        file = self._file(index)
        return self._read.of(_read_map, file, self._kind, self._scale, self._ours, right, keep=_APART)

    def _file(self, index: int) -> Path:
        """Return the file of a frame."""
        if self._ours:
            path = depth_file(self._folder, index)
            if path not in self._files:
                raise VideoError(f"{path} - is missing - run the same mr360uw depth again, which fills gaps")
            return path
        if index >= len(self._files):
            raise VideoError(
                f"{self._folder} - has no map for frame {index} (got {len(self._files)} files) - add the missing ones"
            )
        return self._files[index]


def _read_map(path: Path, kind: Kind, scale_m: float, ours: bool, right: bool) -> DepthMap:
    """Return the map in a file. ours: written by `write_depth`; else kind and scale count. right: of two eyes."""
    confidence: Map | None = None
    if path.suffix.lower() == ".exr":
        parts = read_exr(path)
        if ours and RIGHT in parts:
            parts = {name: part for name, part in parts.items() if (name == RIGHT) == right}
        channels = {name: array for part in parts.values() for name, array in part.items()}
        confidence = channels.get(CONFIDENCE)
        values = channels["Z"] if "Z" in channels else read_rgb(path)[..., 0]
    else:
        codes = read_picture(path)[..., 1]
        values = codes / np.float32(np.iinfo(codes.dtype).max)
    metres = np.asarray(values, np.float32)
    if not ours:
        with np.errstate(divide="ignore"):
            metres = np.float32(scale_m) * (metres if kind == "metric" else np.float32(1.0) / metres)
    known = np.isfinite(metres) & (metres > 0.0)
    sure = np.ones(metres.shape, np.float32) if confidence is None else np.asarray(confidence, np.float32)
    return DepthMap(np.where(known, metres, np.float32(np.inf)), np.where(known, sure, np.float32(0.0)))
