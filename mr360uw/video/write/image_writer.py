# SPDX-License-Identifier: Apache-2.0
"""Writes pictures: one, or a numbered sequence."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import in_plate_primaries
from mr360uw.errors import OutputExistsError, VideoError
from mr360uw.files import NewFile, whole_file
from mr360uw.reading.numbered_files import is_pattern, matching_files, numbered
from mr360uw.video.clip import Clip
from mr360uw.video.exr import write_exr
from mr360uw.video.metadata.spherical import marked
from mr360uw.video.pixels.rgb import codes_from_linear
from mr360uw.video.read.projection import FLOAT_SUFFIXES
from mr360uw.video.video_frame import VideoFrame, whole_frame
from mr360uw.video.write.other_tracks import exr_attributes
from mr360uw.video.write.writer import VideoWriter

_DEEP_SUFFIXES = (".png", ".tif", ".tiff")


class ImageWriter(VideoWriter):
    """One picture, or a sequence numbered by the frames' index; each appears complete or not at all.

    EXR: linear Rec.709, objects not clipped, with frame number, rate, time code and the `envmap` attribute, in single
    precision for plates of floats, which then keep every bit, else in half. PNG and TIFF: 8 bits, or 16 for plates with
    more. JPEG and PNG are marked as panoramas (XMP), except pictures of two eyes, for which there is no mark.
    file: opens incomplete pictures.
    """

    def __init__(self, path: Path, like: Clip, overwrite: bool, file: NewFile = whole_file) -> None:
        self.path, self._clip, self._file = path, like, file
        self._many = is_pattern(path)
        self._written = 0
        there = matching_files(path)[:1] if self._many else []
        if there and not overwrite:
            raise OutputExistsError(f"{there[0][1]} - is already there - choose another name or allow overwriting")
        self.notes = (*like.notes, *(["pictures carry no sound"] if like.sound is not None else []))

    def write(self, frame: VideoFrame) -> None:
        """Write the frame's picture."""
        if self._written and not self._many:
            raise VideoError(
                f"{self.path} - one picture cannot hold several frames - name a pattern such as "
                f"{self.path.stem}_%04d{self.path.suffix}"
            )
        path = numbered(self.path, frame.index) if self._many else self.path
        told = exr_attributes(self._clip, frame.index) if path.suffix.lower() == ".exr" else None
        write_picture(path, whole_frame(frame, self._clip.stereo), self._file, told)
        self._written += 1

    def finish(self) -> None:
        """Nothing is left to do: every picture is complete."""
        if not self._written:
            raise VideoError(f"{self.path} - no frame was written - check the range of frames")

    def abort(self) -> None:
        """Nothing is left to remove: every picture is complete."""


def write_picture(
    path: Path, frame: VideoFrame, file: NewFile = whole_file, attributes: Mapping[str, Any] | None = None
) -> None:
    """Write a frame as a picture, by a temporary name and a rename; the kind follows the suffix.

    file: opens the temporary file. attributes: more entries of an EXR file's header.
    """
    if path.suffix.lower() == ".exr":
        depth = np.float32 if frame.spec.bits == 32 else np.float16
        write_exr(path, frame.light.astype(depth, copy=False), latlong=frame.wrap, file=file, attributes=attributes)
        return
    try:
        with file(path) as part:
            part.write_bytes(_encoded(path, frame))
    except OSError as error:
        raise VideoError(
            f"{path} - cannot be written (got {error.strerror}) - check the folder, its rights and the space"
        ) from error


def _encoded(path: Path, frame: VideoFrame) -> bytes:
    import cv2

    pixels = (
        frame.light
        if path.suffix.lower() in FLOAT_SUFFIXES
        else picture_codes(frame, path.suffix.lower() in _DEEP_SUFFIXES)
    )
    done, data = cv2.imencode(path.suffix, np.ascontiguousarray(pixels[..., ::-1]))
    if not done:
        raise VideoError(f"{path} - this kind of picture cannot be written - take .png, .jpg or .exr")
    return marked(data.tobytes(), frame.shape[1], frame.shape[0]) if frame.wrap else data.tobytes()


def picture_codes(frame: VideoFrame, deep: bool = True) -> NDArray[Any]:
    """Return the RGB code values of a frame, (H, W, 3): uint8, or uint16 where the plate has more and `deep` allows.

    Integer RGB plates keep their codes; linear plates are encoded as sRGB.
    """
    dtype = np.uint16 if deep and frame.spec.bits > 8 else np.uint8
    if frame.rgb is not None and frame.rgb.dtype == dtype:
        return frame.rgb
    own = frame.rgb is not None or frame.spec.mapping is not None
    light = in_plate_primaries(frame.image_linear, frame.spec) if own else frame.image_linear
    return codes_from_linear(light, frame.spec.picture_transfer, dtype, frame.index)
