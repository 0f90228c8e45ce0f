# SPDX-License-Identifier: Apache-2.0
"""Finds the panorama in a frame: the whole of it, or one eye of a stereo pair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from mr360uw.errors import VideoError
from mr360uw.types import YuvImage
from mr360uw.video.metadata.spherical import SphericalMetadata, Stereo
from mr360uw.video.read.picture_shape import Shape, way_out

Eye = Literal["left", "right"]


@dataclass(frozen=True, slots=True)
class Crop:
    """A rectangle of a frame of `frame_size` (width, height)."""

    column: int
    row: int
    width: int
    height: int
    frame_size: tuple[int, int]

    @property
    def is_whole(self) -> bool:
        """Whether nothing is cut away."""
        return (self.width, self.height) == self.frame_size

    def window(self, image: NDArray[Any], scale_x: int = 1, scale_y: int = 1) -> NDArray[Any]:
        """Return the part of an image that is subsampled by the scales."""
        rows = slice(self.row // scale_y, (self.row + self.height) // scale_y)
        return image[rows, self.column // scale_x : (self.column + self.width) // scale_x]

    def apply(self, image: YuvImage) -> YuvImage:
        """Return the part of the planes, as views."""
        scale_x, scale_y = image.y.shape[1] // image.u.shape[1], image.y.shape[0] // image.u.shape[0]
        u, v = (self.window(plane, scale_x, scale_y) for plane in (image.u, image.v))
        return YuvImage(self.window(image.y), u, v, image.spec)


def panorama_crop(
    path: Path,
    width: int,
    height: int,
    spherical: SphericalMetadata | None,
    eye: Eye | None,
    rotation: int = 0,
    equirectangular: bool = True,
    look: Callable[[], Shape] = lambda: "panorama",
) -> Crop:
    """Return the part of a frame that is one full equirectangular panorama, or raise VideoError.

    The stereo layout is taken from the metadata or, without any, from the frame's shape: 1:1 is top-bottom, 4:1 is
    left-right. With `eye` that half is taken. equirectangular False accepts a mono frame of any shape. look: says what
    the picture shows, where its size does not fit.
    """
    if rotation not in (0, 180):
        raise VideoError(
            f"{path} - asks to be turned by {rotation} degrees - turn the pictures upright before "
            "(only 180 is done here)"
        )
    stereo = _stereo(width, height, spherical)
    if not equirectangular and eye is None:
        return Crop(0, 0, width, height, (width, height))
    if spherical is not None and equirectangular:
        _check_projection(path, spherical)
    if stereo == "mono":
        if eye is not None:
            raise VideoError(
                f"{path} - is not stereo (got {width}x{height}), so it has no {eye} eye - leave out the eye"
            )
        crop = Crop(0, 0, width, height, (width, height))
    elif eye is None:
        if spherical is None and look() == "fisheye":
            raise VideoError(f"{path} - {way_out('fisheye')}")
        raise VideoError(
            f"{path} - is {stereo} stereo (got {width}x{height}), and one eye is worked on at a time - choose it: "
            'plate.eye = "left" or "right" in a scene, --eye left on the command line, eye="left" in Python'
        )
    else:
        crop = _eye_crop(path, width, height, stereo, eye)
        if equirectangular and crop.width != 2 * crop.height and width == 2 * height:
            raise VideoError(_squeezed(path, crop, stereo, eye))
    if equirectangular and crop.width != 2 * crop.height:
        size = f"the picture is not a 360 degree panorama of 2:1 (got {crop.width}x{crop.height})"
        raise VideoError(f"{path} - {size} - {way_out(look()) or 'export it as equirectangular 2:1'}")
    return crop


def _stereo(width: int, height: int, spherical: SphericalMetadata | None) -> Stereo:
    if spherical is not None and spherical.stereo != "mono":
        return spherical.stereo
    if width == height:
        return "top-bottom"
    return "left-right" if width == 4 * height else "mono"


def _eye_crop(path: Path, width: int, height: int, stereo: Stereo, eye: Eye) -> Crop:
    if stereo == "top-bottom":
        return Crop(0, 0 if eye == "left" else height // 2, width, height // 2, (width, height))
    if stereo in ("left-right", "right-left"):
        first = (eye == "left") == (stereo == "left-right")
        return Crop(0 if first else width // 2, 0, width // 2, height, (width, height))
    raise VideoError(f"{path} - its stereo layout is not known (got {stereo}) - export one eye as mono")


def _squeezed(path: Path, crop: Crop, stereo: Stereo, eye: Eye) -> str:
    """Return the error message for two eyes squeezed into one 2:1 frame, each to half its width or height."""
    height = max(crop.height, crop.width // 2)
    ffmpeg = (
        f'ffmpeg -i {path.name} -vf "crop={crop.width}:{crop.height}:{crop.column}:{crop.row},'
        f'scale={2 * height}:{height},setsar=1" -c:a copy {eye}.mp4'
    )
    return (
        f"{path} - its two eyes are squeezed into one 2:1 frame, {stereo} (got {crop.width}x{crop.height} for each) - "
        f"stretch one, and take that as a mono plate: {ffmpeg}"
    )


def _check_projection(path: Path, spherical: SphericalMetadata) -> None:
    if spherical.projection != "equirectangular":
        raise VideoError(
            f"{path} - projection not supported (got {spherical.projection}) - export the clip as "
            "equirectangular, or turn it with FFmpeg's filter v360"
        )
    if any(spherical.bounds):
        raise VideoError(
            f"{path} - is only part of the sphere (cropped by {spherical.bounds} at top, bottom, left, right) - export "
            "the full sphere"
        )
