# SPDX-License-Identifier: Apache-2.0
"""Finds the panoramas in a frame: the whole of it, one eye of a stereo pair, or both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from mr360uw.errors import VideoError
from mr360uw.types import YuvImage
from mr360uw.video.metadata.spherical import SphericalMetadata, Stereo
from mr360uw.video.read.picture_shape import ONE_PICTURE, Shape, padded, way_out

Eye = Literal["left", "right", "both"]
Layout = Literal["mono", "top-bottom", "bottom-top", "left-right", "right-left"]
"""Arrangement of the eyes in a frame, the left one named first: it is above, below, at the left or at the right."""
LEFT_FIRST: dict[str, Stereo] = {"right-left": "left-right", "bottom-top": "top-bottom"}
"""Arrangements whose first eye is the right one, and what they are with the left one first."""
_WIDEST = 5.0
"""Largest ratio of width to height of a squeezed panorama: 32:9 is usual (two eyes, one above the other, in 16:9)."""


_CUBES = {"c3x2": (3, 2), "c6x1": (6, 1), "c1x6": (1, 6)}
"""Arrangements of the six faces of a cube by FFmpeg's names, and their width to height."""
_CUBE = "; if it is the six faces of a cube, turn it by ffmpeg -i {} -vf v360={}:e OUT"


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


def panorama_crops(
    path: Path,
    size: tuple[int, int],
    spherical: SphericalMetadata | None,
    eye: Eye | None,
    rotation: int = 0,
    equirectangular: bool = True,
    layout: Layout | None = None,
    look: Callable[[], Shape] = lambda: "panorama",
    pixel_aspect: float = 1.0,
) -> tuple[Crop, Crop | None, Stereo]:
    """Return the part of a frame that is one full equirectangular panorama, that of the right eye beside it where
    `eye` is "both", and the arrangement of the eyes. Raises `VideoError`.

    size: (width, height) of the frame. layout: arrangement of the eyes; None takes it from the metadata or, without
    any, from the frame's shape: 1:1 is top-bottom, 4:1 is left-right. Panoramas are 2:1 unless the layout or the
    metadata say that the frame is one: then their pixels may be wider or higher. equirectangular False accepts a mono
    frame of any shape. look: says what the picture shows, where its size does not fit. pixel_aspect: width of a pixel
    over its height; frames that players show as 2:1 by it are one panorama, whatever their size.
    """
    if rotation not in (0, 180) or (rotation and eye == "both"):
        raise VideoError(
            f"{path} - asks to be turned by {rotation} degrees - turn the pictures upright before "
            "(only 180 is done here, and not for both eyes)"
        )
    width, height = size
    whole = Crop(0, 0, width, height, size)
    if not equirectangular and eye is None:
        return whole, None, "mono"
    if spherical is not None and equirectangular:
        _check_projection(path, spherical)
    stereo = layout or _stereo(width, height, spherical)
    if layout is None and spherical is None and _is_squeezed(width, height, pixel_aspect):
        layout = stereo = "mono"
    said = layout is not None or spherical is not None
    if stereo == "mono" and eye is not None:
        raise VideoError(
            f'{path} - is not stereo (got {width}x{height}), so it has no "{eye}" eye - leave out the eye, or say with '
            'plate.layout = "top-bottom" or "left-right" how its eyes lie'
        )
    if stereo != "mono" and not said and (shape := look()) in ONE_PICTURE:
        raise VideoError(f"{path} - {way_out(shape, path)}; if it is two eyes, say with plate.layout how they lie")
    if stereo == "custom":
        raise VideoError(f"{path} - its stereo layout is not known (got {stereo}) - export one eye as mono")
    if stereo != "mono" and eye is None:
        raise VideoError(
            f"{path} - is {stereo} stereo (got {width}x{height}), and its eyes are not chosen - take "
            'plate.eye = "left", "right" or "both" in a scene, --eye left on the command line, eye="left" in Python'
        )
    crop = whole if stereo == "mono" else _eye_crop(path, width, height, stereo, "right" if eye == "right" else "left")
    if equirectangular and crop.width != 2 * crop.height and not (said and _may_be_squeezed(crop)):
        what = f"the picture is not a 360 degree panorama of 2:1 (got {crop.width}x{crop.height})"
        out = way_out(look(), path) or "export it as equirectangular 2:1, or tag it as the full sphere"
        out += next(
            (_CUBE.format(path.name, name) for name, ratio in _CUBES.items() if width * ratio[1] == height * ratio[0]),
            "",
        )
        raise VideoError(f"{path} - {what} - {out}")
    return crop, _eye_crop(path, width, height, stereo, "right") if eye == "both" else None, stereo


def output_layout(stereo: Stereo) -> Stereo:
    """Return the arrangement of outputs with both eyes: that of the plate, but the left one first: metadata cannot
    say bottom-top, V1 not even right-left, and players that know no other would show them crossed.
    """
    return LEFT_FIRST.get(stereo, stereo)


def _may_be_squeezed(crop: Crop) -> bool:
    """Return whether a picture of a shape other than 2:1 can be a whole panorama, squeezed or stretched."""
    return crop.width <= _WIDEST * crop.height and crop.height <= crop.width and crop.width % 2 == crop.height % 2 == 0


def _is_squeezed(width: int, height: int, pixel_aspect: float) -> bool:
    """Return whether a frame is not 2:1, but is shown so by the shape of its pixels."""
    return width != 2 * height and abs(pixel_aspect * width / height - 2.0) < _SQUEEZED


_SQUEEZED = 0.02
"""Difference from 2:1 of a frame's shown shape that rounding of its pixel aspect makes."""


def _stereo(width: int, height: int, spherical: SphericalMetadata | None) -> Stereo:
    if spherical is not None and spherical.stereo != "mono":
        return spherical.stereo
    if width == height:
        return "top-bottom"
    return "left-right" if width == 4 * height else "mono"


def _eye_crop(path: Path, width: int, height: int, stereo: Stereo, eye: Literal["left", "right"]) -> Crop:
    across, down = (1, 2) if LEFT_FIRST.get(stereo, stereo) == "top-bottom" else (2, 1)
    if width % (2 * across) or height % (2 * down):
        raise VideoError(
            f"{path} - cannot be divided into two eyes, {stereo} (got {width}x{height}) - export it with a "
            f"{'height' if down == 2 else 'width'} that is a multiple of 4 and the other side even"
        )
    first = (eye == "left") == (stereo not in LEFT_FIRST)
    column, row = (0, height // 2) if down == 2 else (width // 2, 0)
    return Crop(0 if first else column, 0 if first else row, width // across, height // down, (width, height))


def _check_projection(path: Path, spherical: SphericalMetadata) -> None:
    if spherical.projection != "equirectangular":
        raise VideoError(
            f"{path} - projection not supported (got {spherical.projection}) - "
            + (
                padded(path, spherical.stereo)
                if spherical.projection in ("half equirectangular", "mesh")
                else "export the clip as equirectangular, or turn it with FFmpeg's filter v360"
            )
        )
    if spherical.is_half:
        eyes = "an eye each of " if spherical.stereo != "mono" else ""
        raise VideoError(
            f"{path} - is VR180 by its tags, {eyes}the half of the sphere in front - {padded(path, spherical.stereo)}"
        )
    if any(spherical.bounds):
        cut = ", ".join(f"{100 * part:.3g} %" for part in spherical.bounds)
        raise VideoError(
            f"{path} - is only part of the sphere (cropped by {cut} at top, bottom, left, right) - "
            "export the full sphere"
        )
