# SPDX-License-Identifier: Apache-2.0
"""Reads pictures as the frames of a plate: a still, or a numbered sequence."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import ColorSpec
from mr360uw.base.constants import MOST_LIGHT
from mr360uw.base.files import is_pattern, matcher, matching_files
from mr360uw.base.input_files import FRAMES, PICTURE
from mr360uw.base.parameters import is_light
from mr360uw.errors import VideoError
from mr360uw.video.clip import PICTURE_SUFFIXES, NamedColors
from mr360uw.video.exr import Wanted
from mr360uw.video.layout import EyeChoice, output_layout, panorama_crops, part_of, shape_of_codes
from mr360uw.video.picture_file import PictureFile, picture_file
from mr360uw.video.picture_tags import PictureTags
from mr360uw.video.planes import peak_code
from mr360uw.video.reader import Chosen, VideoFrame, VideoReader, check_range
from mr360uw.video.spherical import SphericalMetadata

PictureFiles = tuple[tuple[Path, ...], int, tuple[str, ...]]
"""The pictures that a name stands for; number of the first one in its name, 0 of pictures without; and notes on their
names, one line each."""


def picture_files(path: Path) -> PictureFiles | None:
    """Return the pictures that a path, pattern or wildcard names, or None where it names no pictures."""
    # Take a single file as it is
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        return None
    if path.exists():
        return (path,), 0, ()
    # Take the files of a pattern, none missing and none twice, or of a wildcard
    if is_pattern(path):
        hits = matching_files(path)
        for (number, one), (following, other) in pairwise(hits):
            if following == number:
                raise VideoError(
                    f"{path} - has number {number} twice (got {one.name} and {other.name}) - move one of them away"
                )
            if following != number + 1:
                raise VideoError(
                    f"{path} - picture {number + 1} of the sequence is missing (got {number}, then {following}) - "
                    "render it, or name the parts one by one"
                )
        files = [file for _, file in hits]
    elif set(path.name) & set("*?["):
        hits, files = [], sorted(path.parent.glob(path.name))
    else:
        return (path,), 0, ()
    # Refuse what names no file
    if not files:
        raise VideoError(f"{path} - no picture has such a name - check the path and the number of digits")
    return (tuple(files), hits[0][0], _widths(path, files)) if hits else (tuple(files), 0, ())


def _widths(path: Path, files: list[Path]) -> tuple[str, ...]:
    """Return a line where numbers of a sequence are written in several widths, as of two sequences in a folder."""
    name = matcher(path)
    written = [found[1] for file in files if (found := name.fullmatch(file.name))]
    width = next((len(number) for number in written if len(number) > len(str(int(number)))), 0)
    odd = next((file for file, number in zip(files, written, strict=True) if len(number) < width), None)
    if odd is None:
        return ()
    return (
        f"{path} - is written in several widths of its numbers (as {files[0].name} and {odd.name}), and read as one "
        "sequence by them - move what does not belong to it away",
    )


def _one_of_many(path: Path) -> tuple[str, ...]:
    """Return a line where a picture that is named alone is one of a numbered sequence."""
    found = _LAST_NUMBER.fullmatch(path.stem)
    if found is None:
        return ()
    pattern = path.with_name(f"{found[1]}{'#' * len(found[2])}{found[3]}{path.suffix}")
    number = int(found[2])
    beside = [file for other, file in matching_files(pattern) if abs(other - number) == 1]
    if not beside:
        return ()
    return (
        f"{path} - is one of a sequence (as {beside[0].name} beside it), and is read as a still - name {pattern.name} "
        "to have all of it",
    )


_LAST_NUMBER = re.compile(r"(.*?)(\d{3,})(\D*)")
"""Name of a picture with a number of three digits or more: cameras count their stills too, but with gaps."""


class ImageReader(VideoReader):
    """A still or a sequence of pictures as a plate; made by `open_video`. Frame k is the k-th picture by number."""

    def __init__(
        self,
        path: Path,
        named: PictureFiles,
        frame_rate: Fraction,
        colors: NamedColors,
        eyes: EyeChoice,
        equirectangular: bool,
        wanted: Wanted,
    ) -> None:
        files, first_number, said = named
        picture = picture_file(files[0], wanted, notes=wanted == "colour")
        self._files, self._wrap, self._wanted, self._mapping = files, equirectangular, wanted, picture.mapping
        notes = [*said, *picture.notes, *(_one_of_many(path) if path == files[0] else ())]
        # A part of a panorama is placed in the whole, by the mark of the first picture
        pano = picture.tags.pano if equirectangular and eyes[1] is None else {}
        self._placed, projection = _placed(path, picture.tags, pano), pano.get("ProjectionType", "equirectangular")
        notes += _pano_notes(path, picture.tags, self._placed) if pano else ()
        marked = None if projection == "equirectangular" else SphericalMetadata(projection, source="XMP")
        whole = _in_panorama(picture.codes, self._placed)
        self._size = whole.shape[1], whole.shape[0]
        self._crop, self._beside, stereo = panorama_crops(
            path, self._size, marked, eyes, equirectangular, lambda: shape_of_codes(whole, 8 * whole.dtype.itemsize)
        )
        spec, unused = _spec_of(path, picture, colors, wanted)
        self._matte_alpha = wanted == "matte" and _alpha_counts(files, picture)
        if wanted == "matte":
            notes += _matte_notes(path, picture, self._matte_alpha)
        super().__init__(
            path=path,
            width=self._crop.width,
            height=self._crop.height,
            frame_rate=frame_rate,
            time_base=1 / frame_rate,
            spec=spec,
            codec_name=files[0].suffix.lower().lstrip("."),
            is_still=len(files) == 1,
            panorama=equirectangular,
            stereo=output_layout(stereo) if self._beside is not None else "mono",
            notes=(*notes, *unused),
            first_number=first_number,
            picture_tags=picture.tags,
        )

    @property
    def frame_count(self) -> int | None:
        """Number of pictures; None for a still, which has as many frames as are asked for."""
        return None if self.is_still else len(self._files)

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop), stop filled in; VideoError where the sequence does not hold all of these frames."""
        if not self.is_still:
            return check_range(self.path, start, stop, len(self._files))
        start, stop = check_range(self.path, start, start + 1 if stop is None else stop, sys.maxsize)
        FRAMES.check(f"{self.path} frames", stop, VideoError)
        return start, stop

    def file_of(self, index: int) -> Path:
        """Return the picture of a frame."""
        return self._files[0 if self.is_still else min(index, len(self._files) - 1)]

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames start <= index < stop; a still repeats, one frame by default."""
        return self._read(*self.check_range(start, stop))

    def sampled(self, start: int, stop: int, chosen: Chosen) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; the files of those that are not chosen are not opened."""
        return self._read(*self.check_range(start, stop), chosen)

    def _read(self, start: int, stop: int, chosen: Chosen = lambda _: True) -> Iterator[VideoFrame]:
        read = self._codes(self._files[0]) if self.is_still else None
        for index in range(start, stop):
            time_s = float(index * self.time_base)
            frame = VideoFrame(index, index, self.time_base, time_s, 1, self.spec, wrap=self._wrap)
            if not chosen(index):
                yield frame
                continue
            both, tags = read if read is not None else self._codes(self._files[index])
            frame = replace(frame, rgb=both[0], picture_tags=tags)
            yield frame if len(both) == 1 else replace(frame, right=replace(frame, rgb=both[1]))

    def _codes(self, path: Path) -> tuple[list[NDArray[Any]], PictureTags]:
        """Return the codes of a picture, of both eyes where they are read, and its metadata."""
        # Read the picture into the panorama
        picture = picture_file(path, self._wanted)
        codes = _in_panorama(picture.codes, self._placed)
        if self._wanted == "matte":
            codes = _grey_codes(codes, alpha=self._matte_alpha)
        # Refuse what differs from the first picture, or holds no light
        if (codes.shape[1], codes.shape[0]) != self._size or 8 * codes.dtype.itemsize != self.spec.bits:
            raise VideoError(
                f"{path} - differs from the first picture of the sequence (got {codes.shape[1]}x{codes.shape[0]} "
                f"{codes.dtype}) - use pictures of one size and depth"
            )
        if self._wanted == "colour" and picture.mapping != self._mapping:
            raise VideoError(
                f"{path} - has other colours than the first picture of the sequence (its profile or its primaries) - "
                "use pictures of one kind"
            )
        if self._wrap and codes.dtype.kind == "f" and not is_light(codes):
            got = f"got NaN, infinity or more than {MOST_LIGHT:g}"
            raise VideoError(f"{path} - holds samples that are no light ({got}) - repair the picture")
        # Cut out the eyes; the metadata keep where the picture lay
        codes.flags.writeable = False
        tags = picture.tags
        if self._placed is not None:
            tags = replace(tags, full_size=self._placed[0], origin=self._placed[1])
        return [part_of(codes, crop) for crop in (self._crop, self._beside) if crop is not None], tags


def _spec_of(path: Path, picture: PictureFile, named: NamedColors, wanted: Wanted) -> tuple[ColorSpec, tuple[str, ...]]:
    """Return how a picture's codes are read, and a line where that is not as its file says."""
    transfer, primaries = named
    bits, linear = 8 * picture.codes.dtype.itemsize, picture.codes.dtype.kind == "f"
    own = picture.transfer or ("linear" if linear else "srgb")
    spec = ColorSpec("bt709", True, transfer or own, bits, primaries or picture.primaries)
    if transfer is None and primaries is None and wanted == "colour":
        return (spec if picture.mapping is None else spec.mapped(picture.mapping)), ()
    if wanted != "colour" or (picture.mapping is None and picture.transfer in (None, transfer)):
        return spec, ()
    return spec, (
        f"{path} - says its colours itself, which are not used for plate.transfer or plate.primaries says others - "
        "leave these out to have them used",
    )


_Place = tuple[tuple[int, int], tuple[int, int]]
"""Where a picture lies in a panorama: (width, height) of all of that, and (column, row) of its own top left pixel."""


def _placed(path: Path, tags: PictureTags, pano: Mapping[str, str]) -> _Place | None:
    """Return where a picture lies in its panorama by its mark; None where it is all of it, or is not marked.

    Pictures that were resized after they were marked are placed in proportion. Raises `VideoError` for a mark that
    cannot be.
    """
    of_full, of_part = ("FullPanoWidthPixels", "FullPanoHeightPixels"), ("ImageWidthPixels", "ImageHeightPixels")
    names = (*of_full, *(f"CroppedArea{name}" for name in (*of_part, "LeftPixels", "TopPixels")))
    try:
        full_width, full_height, width, height, left, top = (float(pano[name]) for name in names)
        scale = tags.size[0] / width
        size, at = (round(full_width * scale), round(full_height * scale)), (round(left * scale), round(top * scale))
    except (KeyError, ValueError, ArithmeticError):
        return None
    if size == tags.size:
        return None
    right, bottom = at[0] + tags.size[0], at[1] + tags.size[1]
    if min(at) < 0 or right > size[0] or bottom > size[1] or size[0] != 2 * size[1]:
        raise VideoError(
            f"{path} - is marked as a part of a panorama that cannot be (got {width:g}x{height:g} at {left:g},{top:g} "
            f"of {full_width:g}x{full_height:g}) - correct its GPano tags, or remove them"
        )
    PICTURE.check(str(path), size[0] * size[1], VideoError)
    return size, at


def _in_panorama(codes: NDArray[Any], placed: _Place | None) -> NDArray[Any]:
    """Return the codes of the whole panorama, black where the picture has none; the codes themselves for None."""
    if placed is None:
        return codes
    (width, height), (column, row) = placed
    out = np.zeros((height, width, codes.shape[-1]), codes.dtype)
    part = out[row : row + codes.shape[0], column : column + codes.shape[1]]
    part[...] = codes[: part.shape[0], : part.shape[1]]
    return out


def _pano_notes(path: Path, tags: PictureTags, placed: _Place | None) -> Iterator[str]:
    """Yield lines on what of a panorama's mark is not used."""
    if placed is not None:
        yield (
            f"{path} - is a part of a panorama of {placed[0][0]}x{placed[0][1]} (its GPano tags), whose "
            "rest is black: no light comes from there - pictures are written cropped as it is; fill the rest to have "
            "it lit whole"
        )
    if heading := tags.pose_deg[0]:
        yield (
            f"{path} - says that its middle looks {heading:g} degrees from north (GPano), which is not used - take it "
            "off compass directions where you set them, as light.sun_azimuth_deg"
        )


def _opaque(codes: NDArray[Any]) -> bool:
    """Return whether a matte's picture has no alpha, or one that covers all."""
    return codes.shape[-1] < 4 or bool(np.all(codes[..., 3] >= peak_code(codes)))


def _alpha_counts(files: tuple[Path, ...], first: PictureFile) -> bool:
    """Return whether the alpha of mattes is taken: where it is not opaque in the first, middle or last picture."""
    some = [files[len(files) // 2], files[-1]] if len(files) > 1 else []
    return not _opaque(first.codes) or any(not _opaque(picture_file(file, "matte").codes) for file in some)


def _grey_codes(codes: NDArray[Any], *, alpha: bool) -> NDArray[Any]:
    """Return a matte's codes (H, W, 3): its alpha, or its colours."""
    if not alpha:
        return codes[..., :3]
    if codes.shape[-1] < 4:
        return np.full((*codes.shape[:2], 3), peak_code(codes), codes.dtype)
    return np.repeat(codes[..., 3:], 3, axis=-1)


def _matte_notes(path: Path, picture: PictureFile, alpha: bool) -> Iterator[str]:
    """Yield a line where both the colours and the alpha of a matte say something, and not the same."""
    codes = picture.codes
    if not alpha or codes.shape[-1] < 4:
        return
    grey = codes[..., :3].astype(np.float64).mean(axis=-1)
    apart = np.abs(grey - codes[..., 3]).max() > 0.01 * float(max(np.max(codes[..., 3]), 1e-9))
    if np.ptp(grey) > 0.0 and apart:
        yield (
            f"{path} - says something in its colours and something else in its alpha: the alpha is the matte - save it "
            "without alpha to have the colours used"
        )
