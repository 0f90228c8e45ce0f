# SPDX-License-Identifier: Apache-2.0
"""Frames of plates, the interface of plates, and plates made of others: smaller ones for drafts, and ones whose frames
are kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import ColorSpec, brightest_light, in_plate_primaries, in_rec709
from mr360uw.base.tile_blend import blended, light_sum
from mr360uw.errors import ParameterError, VideoError
from mr360uw.types import Floats, Layer, Rectangle, Tile, YuvImage
from mr360uw.video.clip import Clip
from mr360uw.video.spherical import Stereo

if TYPE_CHECKING:
    from mr360uw.video.picture_tags import PictureTags
    from mr360uw.video.planes import Grain

Check = Callable[[int, Tile], object]
"""Raises an error where a number of a tile is not finite."""


class Grade(Protocol):
    """Colour of a grade, between light and the light that graded codes show; all (..., 3) linear Rec.709, float32."""

    def lay_on(self, linear: Floats, spec: ColorSpec) -> NDArray[np.float32]:
        """Return the graded light."""

    def take_off(self, linear: Floats, spec: ColorSpec) -> NDArray[np.float32]:
        """Return the light before the grade."""


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """One picture of a plate.

    index: position in order of presentation, from 0. pts, time_base: presentation time stamp as the container has
    it. time_s: seconds since the first frame. duration: in units of time_base, 0 where unknown. spec: how the codes
    are read. yuv: the planes (views, read-only) or None for RGB plates. rgb: code values (H, W, 3) of an RGB plate,
    uint8 or uint16, or linear float32, else None. native: the decoder's frame that owns exactly these planes, if any.
    wrap: the left and right edges meet (a full panorama). damage: whether the decoder guessed a part of the picture
    ("concealed"), or the frame could not be decoded and is the last good one ("held"). right: of a stereo plate whose
    left eye this is, the right one at the same instant. clipped: of a composite, the light (h, w, 3) of tiles in which
    some is brighter than the codes can say. plate: of a composite of planes, what it was laid over. grade: of the
    codes, None for none: light is read without it and written with it; a composite holds its codes alone. picture_tags:
    metadata of the picture that it was read from. With neither yuv nor rgb it was passed over (`VideoReader.sampled`).
    """

    index: int
    pts: int
    time_base: Fraction
    time_s: float
    duration: int
    spec: ColorSpec
    yuv: YuvImage | None = None
    rgb: NDArray[Any] | None = None
    native: Any = None
    wrap: bool = True
    damage: Literal["none", "concealed", "held"] = "none"
    right: VideoFrame | None = None
    clipped: tuple[tuple[Rectangle, NDArray[np.float32]], ...] = ()
    plate: VideoFrame | None = None
    grade: Grade | None = None
    picture_tags: PictureTags | None = None

    @classmethod
    def of_linear(cls, image_linear: NDArray[np.float32], index: int = 0, time_s: float = 0.0) -> VideoFrame:
        """Return the frame of a picture of linear Rec.709 light (H, W, 3), float32."""
        spec = ColorSpec("bt709", True, "linear", 32)
        return cls(index, 0, Fraction(1), time_s, 0, spec, rgb=image_linear)

    @property
    def is_read(self) -> bool:
        """Whether the frame has codes; not where a pass went by it."""
        return self.yuv is not None or self.rgb is not None

    @property
    def pixels(self) -> YuvImage | NDArray[np.float32]:
        """The planes where the frame has them and no grade, else its linear picture.

        Of a grade it is within 0 and, of codes whose brightest is white, 1: what is beyond is the encoder's overshoot.
        """
        if self.grade is not None:
            return self._lit
        return self.yuv if self.yuv is not None else self.image_linear

    @cached_property
    def _lit(self) -> NDArray[np.float32]:
        coded = self.rgb is None or self.rgb.dtype.kind == "u"
        return np.clip(self.image_linear, 0.0, 1.0 if coded and not self.spec.is_wide else np.inf)

    def graded_by(self, grade: Grade | None) -> VideoFrame:
        """Return the frame, and its right eye, as of codes with a grade; the frame itself where it has that."""
        right = None if self.right is None else self.right.graded_by(grade)
        return self if self.grade is grade and right is self.right else replace(self, grade=grade, right=right)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        image = self.yuv.y if self.yuv is not None else self.rgb
        assert image is not None
        return int(image.shape[0]), int(image.shape[1])

    @cached_property
    def image_linear(self) -> NDArray[np.float32]:
        """The picture as linear Rec.709, (H, W, 3) float32, not clipped."""
        height, width = self.shape
        return self.linear(Rectangle(0, 0, width, height))

    @property
    def light(self) -> NDArray[np.float32]:
        """The picture as linear Rec.709 (H, W, 3), with what a composite has above the brightest code.

        Codes of a composite outside of the plate's gamut, as where a dark edge shares its chroma with what is beside
        it, are those that a screen shows: there is no negative light but the plate's own.
        """
        if not self.clipped and self.plate is None:
            return self.image_linear
        image = self.image_linear.copy()
        if self.plate is not None:
            shown, own = (in_plate_primaries(one, self.spec) for one in (image, self.plate.image_linear))
            least = np.minimum(own, 0.0)
            darker = np.any(shown < least, axis=-1)
            image[darker] = in_rec709(np.maximum(shown[darker], least[darker]), self.spec)
        for rectangle, linear in self.clipped:
            column, row, width, height = rectangle
            part = image[row : row + height, column : column + width]
            np.copyto(part, linear, where=np.any(linear > brightest_light(self.spec), axis=-1, keepdims=True))
        return image

    def linear(self, rectangle: Rectangle) -> NDArray[np.float32]:
        """Return a part of the picture as linear Rec.709, (h, w, 3) float32, not clipped."""
        if self.yuv is not None:
            from mr360uw.yuv.decoding import linear_from_planes

            return self._ungraded(linear_from_planes(self.yuv, rectangle, self.wrap))
        from mr360uw.video.planes import linear_from_codes

        assert self.rgb is not None
        column, row, width, height = rectangle
        codes = self.rgb[row : row + height, column : column + width]
        return self._ungraded(in_rec709(linear_from_codes(codes, self.spec.transfer), self.spec))

    def halved(self, rectangle: Rectangle) -> NDArray[np.float32]:
        """Return `linear` of a part of even place and size at half its columns and rows, (h/2, w/2, 3), for blurs.

        Planes are averaged as codes, which is off by half the light's curvature over the codes times their variance
        within a pixel: by 1e-3 of the light where they vary by 3 of 255.
        """
        import cv2

        from mr360uw.yuv.decoding import linear_from_planes, subsampling

        column, row, width, height = rectangle
        size = width // 2, height // 2
        if self.yuv is None or subsampling(self.yuv) != (1, 1):
            return np.asarray(cv2.resize(self.linear(rectangle), size, interpolation=cv2.INTER_AREA), np.float32)
        luma = cv2.resize(self.yuv.y[row : row + height, column : column + width], size, interpolation=cv2.INTER_AREA)
        half = slice(row // 2, row // 2 + size[1]), slice(column // 2, column // 2 + size[0])
        reduced = YuvImage(np.asarray(luma), self.yuv.u[half].copy(), self.yuv.v[half].copy(), self.spec)
        return self._ungraded(linear_from_planes(reduced, wrap=False))

    def _ungraded(self, linear: NDArray[np.float32]) -> NDArray[np.float32]:
        return linear if self.grade is None else self.grade.take_off(linear, self.spec)

    @cached_property
    def grain(self) -> Grain:
        """The grain of the picture."""
        from mr360uw.video.planes import grain_of_planes, grain_of_rgb

        if self.yuv is not None:
            return grain_of_planes(self.yuv, self.wrap)
        assert self.rgb is not None
        return grain_of_rgb(self.rgb, self.spec.transfer, self.wrap)

    def over(self, layer: Layer, grain: float = 0.0, check: Check | None = None) -> VideoFrame:
        """Return the composite of the layer's tiles over the frame (`tile_blend`).

        grain: amount of the plate's grain that is added where the layer covers it, 0 none, 1 as much as the plate has.
        check: called with the frame's index and tiles whose composite is not finite. The frame itself is left alone;
        where the layer has no tile, and at every pixel without coverage, radiance and change of the plate's light, the
        codes stay what they were. Light above 1 is clipped to the top code (EXR plates keep it).
        """
        if not layer.tiles:
            return self.graded_by(None)
        if (layer.height, layer.width) != self.shape:
            raise VideoError(
                f"frame {self.index} - the layer has another size (got {layer.width}x{layer.height} over "
                f"{self.shape[1]}x{self.shape[0]}) - render it at the plate's size"
            )
        for tile in layer.tiles:
            rows, columns = tile.window
            if min(rows.start, columns.start) < 0 or rows.stop > layer.height or columns.stop > layer.width:
                raise VideoError(
                    f"frame {self.index} - a tile reaches out of the frame (got rows {rows.start}:{rows.stop}, columns "
                    f"{columns.start}:{columns.stop}) - cut it at the edges"
                )
        grain = grain if any(np.any(tile.alpha > 0.0) for tile in layer.tiles) else 0.0
        if self.yuv is None or self.grade is not None or not self.spec.is_rec709:
            layer = layer.laid()  # else the ground is worked out where it is laid over the planes
        write = self._over_codes if self.yuv is None else self._over_planes
        return write(layer, grain, check)

    def _over_planes(self, layer: Layer, amount: float, check: Check | None) -> VideoFrame:
        from mr360uw.video.planes import NO_GRAIN, lay_over_planes, native_frame, plane_views

        assert self.yuv is not None
        native = native_frame(self.yuv, self.native.format.name if self.native is not None else None)
        planes = plane_views(native, self.yuv.spec)
        grain = NO_GRAIN
        if amount > 0.0:
            grain = replace(self.grain, deviation=np.float32(amount) * self.grain.deviation)
        top, clipped = brightest_light(self.spec), []
        for tile in layer.tiles:
            graded = None if self.grade is None else self._graded(blended(self.linear(tile.rectangle), tile), tile)
            brightest, total = lay_over_planes(
                self.yuv, planes, tile, self.index, self.wrap, grain, graded, layer.ground
            )
            finite = bool(np.isfinite(total))
            if finite and brightest <= top:
                continue
            # Say where it is not finite, or keep the light that the codes clip
            whole = tile if layer.ground is None else layer.ground.lay(tile)
            if check is not None and not finite:
                check(self.index, whole)
            if brightest > top:
                image = blended(self.linear(tile.rectangle), whole) if graded is None else graded
                clipped.append((tile.rectangle, np.asarray(image, np.float32)))
        for plane in (planes.y, planes.u, planes.v):
            plane.flags.writeable = False
        return replace(self, yuv=planes, native=native, clipped=tuple(clipped), plate=self.graded_by(None), grade=None)

    def _over_codes(self, layer: Layer, amount: float, check: Check | None) -> VideoFrame:
        from mr360uw.video.planes import add_grain, lay_over_codes

        assert self.rgb is not None
        codes = self.rgb.copy()
        top, clipped = brightest_light(self.spec) if codes.dtype.kind == "u" else np.inf, []
        for tile in layer.tiles:
            # Lay the tile over the light of the codes
            rectangle, linear = tile.rectangle, blended(self.linear(tile.rectangle), tile)
            if check is not None and not np.isfinite(light_sum(linear)):
                check(self.index, tile)
            linear = self._graded(linear, tile)
            # Give it grain, in the values that this is measured in, and write what changes
            if amount > 0.0 and self.spec.mapping is None:
                linear = add_grain(linear, tile, self.grain, amount, layer.width, self.index)
            if linear.max() > top:
                clipped.append((rectangle, np.asarray(linear, np.float32)))
            linear = in_plate_primaries(linear, self.spec)
            if amount > 0.0 and self.spec.mapping is not None:
                linear = add_grain(linear, tile, self.grain, amount, layer.width, self.index)
            lay_over_codes(codes, linear, tile, self.spec.transfer, self.index)
        codes.flags.writeable = False
        return replace(self, rgb=codes, clipped=tuple(clipped), grade=None)

    def _graded(self, linear: Floats, tile: Tile) -> Floats:
        """Return the composite of a tile, linear (h, w, 3), as the codes show it."""
        if self.grade is None:
            return linear
        graded = self.grade.lay_on(linear, self.spec)
        if self.rgb is None or self.rgb.dtype.kind != "f":
            return graded
        # Saturation takes no more from a channel than it has, as codes do by their range
        return np.maximum(graded, np.minimum(self.graded_by(None).linear(tile.rectangle), 0.0))


def whole_frame(frame: VideoFrame, stereo: Stereo) -> VideoFrame:
    """Return a frame with its right eye beside or below it, arranged as `stereo` says; itself for mono.

    The codes are copied. The result is no panorama: its edges do not meet.
    """
    right = frame.right
    if right is None:
        return frame
    axis = 0 if stereo == "top-bottom" else 1

    def joined(left: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
        both = np.concatenate([left, other], axis=axis)
        both.flags.writeable = False
        return both

    # Move what was noted of the right eye to its place
    down, across = (frame.shape[0], 0) if axis == 0 else (0, frame.shape[1])
    beside = tuple((r._replace(row=r.row + down, column=r.column + across), light) for r, light in right.clipped)
    clipped = frame.clipped + beside
    plate = None
    if frame.plate is not None or right.plate is not None:
        plate = whole_frame(replace(frame.plate or frame, right=right.plate or right), stereo)
    # Join codes of RGB pictures, or planes
    if frame.yuv is None or right.yuv is None:
        assert frame.rgb is not None
        assert right.rgb is not None
        return replace(frame, rgb=joined(frame.rgb, right.rgb), native=None, wrap=False, right=None, clipped=clipped)
    a, b = frame.yuv, right.yuv
    planes = YuvImage(joined(a.y, b.y), joined(a.u, b.u), joined(a.v, b.v), a.spec)
    return replace(frame, yuv=planes, native=None, wrap=False, right=None, clipped=clipped, plate=plate)


# --- Plates ---------------------------------------------------------------------------------------------------------


Damaged = Literal["stop", "hold"]
"""What happens at a frame that cannot be decoded: an error, or the last good frame once more."""
Decoder = Literal["software", "auto"]

Seeker = Callable[[int], Iterator[VideoFrame]]
"""Frames from a start on, to the end of the clip; of a still its one."""
Chosen = Callable[[int], bool]
"""Whether a frame of an index is asked for."""


class VideoReader(Clip, ABC):
    """A plate; made by `open_video`. Its metadata: see `Clip`."""

    @property
    def intact_frames(self) -> int | None:
        """Number of frames from the first on whose data are there; less than `frame_count` in a file cut short."""
        return self.frame_count

    @property
    def doubts(self) -> tuple[str, ...]:
        """Notes on signs that the plate is not all there, one line each."""
        return ()

    @abstractmethod
    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; VideoError where the plate does not hold all of these frames."""

    def numbered_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return the frames (start, stop) whose numbers [start, stop) are those in the names of a sequence's files.

        Start 0 is the first frame, stop None the end. Clips without such numbers count from 0: as `check_range`.
        """
        first, count = self.first_number, self.frame_count
        if not first or count is None:
            return self.check_range(start, stop)
        begin, end = start or first, first + count if stop is None else stop
        if not first <= begin < end <= first + count:
            raise VideoError(
                f"{self.path} - frames outside the sequence (got {start}:{'' if stop is None else stop}, its files are "
                f"numbered {first} to {first + count - 1}) - take a range within {first}:{first + count}"
            )
        return self.check_range(begin - first, end - first)

    def file_of(self, index: int) -> Path:  # noqa: ARG002 - sequences have one for each frame
        """Return the file that holds a frame."""
        return self.path

    @abstractmethod
    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames start <= index < stop (to the end by default).

        Frame k is the same however it is reached. The range is checked at once, the frames are decoded as they are
        asked for. Use each iterator from one thread; several may run side by side.
        """

    def sampled(self, start: int, stop: int, chosen: Chosen) -> Iterator[VideoFrame]:  # noqa: ARG002 - of files
        """Return an iterator over the same frames, of which those that are not chosen may come without codes.

        That is where reading them takes time: in video, pictures that no other is decoded from. A few that are chosen
        may lack their codes too. chosen: of an index, asked on the thread that reads, some frames ahead.
        """
        return self.frames(start, stop)

    @contextmanager
    def seeker(self) -> Iterator[Seeker]:
        """Yield a function of a start that returns the frames from there on, to go to and fro in a file kept open.

        Each call ends the pass of the one before.
        """
        yield self.frames

    def entry_before(self, index: int) -> int:
        """Return the last frame up to another that is read without others before it."""
        return index

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the plate; no file stays open between passes."""
        return


class ReaderOver(VideoReader):
    """A plate made of another one, whose frames it changes or keeps. changed: metadata that differ from the other's."""

    def __init__(self, plate: VideoReader, **changed: Any) -> None:
        kept: dict[str, Any] = {field.name: getattr(plate, field.name) for field in fields(Clip)}
        super().__init__(**(kept | changed))
        self._plate = plate

    @property
    def frame_count(self) -> int | None:
        """Number of frames; None for a still."""
        return self._plate.frame_count

    @property
    def intact_frames(self) -> int | None:
        """Number of frames whose data are there; see `VideoReader`."""
        return self._plate.intact_frames

    @property
    def doubts(self) -> tuple[str, ...]:
        """Notes on signs that the plate is not all there."""
        return self._plate.doubts

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; see `VideoReader`."""
        return self._plate.check_range(start, stop)

    def file_of(self, index: int) -> Path:
        """Return the file that holds a frame."""
        return self._plate.file_of(index)

    def entry_before(self, index: int) -> int:
        """Return the last frame up to another that is read without others before it."""
        return self._plate.entry_before(index)


def check_range(path: Path, start: int, stop: int | None, count: int) -> tuple[int, int]:
    """Return (start, stop), stop filled in with the count; VideoError unless 0 <= start < stop <= count."""
    if not isinstance(start, int | np.integer) or not isinstance(stop, int | np.integer | None):
        raise VideoError(f"{path} - frames must be whole numbers (got {start!r:.20}, {stop!r:.20}) - take 0 to {count}")
    end = count if stop is None else stop
    if not 0 <= start < end <= count:
        raise VideoError(
            f"{path} - frames outside the clip (got {start}:{'' if stop is None else stop}, the clip has "
            f"{count} frames) - take a range within 0:{count}"
        )
    return start, end


_LEAST_ROWS = 16


def scaled(plate: VideoReader, scale: float) -> VideoReader:
    """Return a plate with frames of `scale` times its width and height, rounded to even sizes; itself where they
    have that size.

    Raises `ParameterError` unless 0 < scale <= 1 and at least 16 rows are left.
    """
    width, height = scaled_size(plate, scale)
    return plate if (width, height) == (plate.width, plate.height) else _ScaledReader(plate, width=width, height=height)


def scaled_size(plate: Clip, scale: float) -> tuple[int, int]:
    """Return the width and height of the frames of `scaled`; raise as it does."""
    if scale == 1.0:
        return plate.width, plate.height
    if not 0.0 < scale <= 1.0:
        raise ParameterError(f"scale - must be > 0 and <= 1 (got {scale}) - give 0.25 for a quarter of the width")
    width, height = (2 * round(0.5 * scale * size) for size in (plate.width, plate.height))
    if height < _LEAST_ROWS:
        raise ParameterError(
            f"scale - leaves frames of {width}x{height} of {plate.width}x{plate.height} (got {scale}) - give at least "
            f"{_LEAST_ROWS / plate.height:.2g}"
        )
    return width, height


class _ScaledReader(ReaderOver):
    """Reduces frames by `smaller`. Frames keep their index and time stamps."""

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; see `VideoReader`."""
        return (smaller(frame, self.width, self.height) for frame in self._plate.frames(start, stop))

    def sampled(self, start: int, stop: int, chosen: Chosen) -> Iterator[VideoFrame]:
        """Return an iterator over the frames, some without codes; see `VideoReader`."""
        found = self._plate.sampled(start, stop, chosen)
        return (smaller(frame, self.width, self.height) if frame.is_read else frame for frame in found)


def smaller(frame: VideoFrame, width: int, height: int) -> VideoFrame:
    """Return a frame reduced to an even size; every pixel is the mean of the codes that it covers."""
    if frame.shape == (height, width):
        return frame
    if frame.right is not None:
        frame = replace(frame, right=smaller(frame.right, width, height))
    if frame.yuv is None:
        assert frame.rgb is not None
        return replace(frame, rgb=_reduced(frame.rgb, width, height))
    old, (rows, columns) = frame.yuv, frame.shape
    y, u, v = (
        _reduced(plane, width * plane.shape[1] // columns, height * plane.shape[0] // rows)
        for plane in (old.y, old.u, old.v)
    )
    return replace(frame, yuv=YuvImage(y, u, v, old.spec), native=None)


def _reduced(plane: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    import cv2

    small = np.asarray(cv2.resize(np.ascontiguousarray(plane), (width, height), interpolation=cv2.INTER_AREA))
    small.flags.writeable = False
    return small


_MOST_BYTES = 512 << 20
"""Bytes of frames that are kept, where all of a range fit: 46 of 3840 x 1920 with 8 bits. Twice as many, runs over
clips up to twice as long decode once, and take half a gigabyte more."""


class DecodedOnce(ReaderOver):
    """A plate that keeps the frames [a, b) as they are read, and hands them out again; none where they are too many.

    What was worked out from a frame's codes is not kept.
    """

    def __init__(self, plate: VideoReader, span: tuple[int, int]) -> None:
        super().__init__(plate)
        self._span = range(*span)
        self._kept: dict[int, VideoFrame] = {}

    @property
    def are_all(self) -> bool:
        """Whether all frames of the range are kept."""
        return len(self._kept) == len(self._span)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; see `VideoReader`."""
        start, stop = self.check_range(start, stop)
        if all(index in self._kept for index in range(start, stop)):
            return (_anew(self._kept[index]) for index in range(start, stop))
        return map(self._seen, self._plate.frames(start, stop))

    def sampled(self, start: int, stop: int, chosen: Chosen) -> Iterator[VideoFrame]:
        """Return an iterator over the frames: all where they are kept, else as the plate's; see `VideoReader`."""
        frames = self.frames(start, stop)
        first = next(frames)
        yield first
        if first.index in self._kept:
            yield from frames
        elif first.index + 1 < stop:
            yield from self._plate.sampled(first.index + 1, stop, chosen)

    def _seen(self, frame: VideoFrame) -> VideoFrame:
        """Return a frame that has been read; keep it, where it is one of those."""
        if frame.index in self._span and len(self._span) * _size(frame) <= _MOST_BYTES:
            self._kept[frame.index] = _anew(frame)
        return frame


def _anew(frame: VideoFrame) -> VideoFrame:
    """Return a frame of the same codes, with nothing worked out from them."""
    return replace(frame, right=None if frame.right is None else _anew(frame.right))


def _size(frame: VideoFrame) -> int:
    """Return the bytes of a frame's codes."""
    planes = (frame.rgb,) if frame.yuv is None else (frame.yuv.y, frame.yuv.u, frame.yuv.v)
    own = sum(plane.nbytes for plane in planes if plane is not None)
    return own if frame.right is None else own + _size(frame.right)
