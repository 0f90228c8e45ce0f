# SPDX-License-Identifier: Apache-2.0
"""Opens plates of every kind and projection, and begins outputs: video files, sequences, single pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av.filter
import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import Primaries, Transfer
from mr360uw.base.files import check_outputs
from mr360uw.base.parameters import checked, file_path
from mr360uw.errors import VideoError
from mr360uw.types import YuvImage
from mr360uw.video.clip import (
    FFMPEG_NAMES,
    FISHEYE_FOV_DEG,
    PICTURE_SUFFIXES,
    Clip,
    EncodeSettings,
    NamedColors,
    Projection,
    checked_rate,
    joined_row,
    projection_of,
    second_lens,
    turned_by_ffmpeg,
)
from mr360uw.video.container import ContainerReader
from mr360uw.video.demux import track_sizes
from mr360uw.video.exr import Wanted
from mr360uw.video.images import ImageReader, picture_files
from mr360uw.video.layout import Eye, Layout
from mr360uw.video.planes import native_frame, plane_views
from mr360uw.video.reader import Damaged, Decoder, ReaderOver, Seeker, VideoFrame, VideoReader
from mr360uw.video.writer import ImageWriter, VideoWriter


@checked
def open_video(
    path: str | Path,
    transfer: Transfer | None = None,
    *,
    primaries: Primaries | None = None,
    eye: Eye | None = None,
    frame_rate: Fraction | float = 30,
    equirectangular: bool = True,
    depth: bool = False,
    matte: bool = False,
    damaged: Damaged = "stop",
    projection: Projection = "auto",
    fisheye_fov_deg: float = FISHEYE_FOV_DEG,
    layout: Layout | None = None,
    decoder: Decoder = "software",
) -> VideoReader:
    """Open a plate: a video (mp4, mov, mkv, webm ...), one picture, or a sequence of pictures.

    Frames are decoded as they are asked for, and frame k is the same wherever decoding begins. Light is linear: code
    values go through the inverse of the file's curve.

    Parameters
    ----------
    path : str or Path
        A file, or the pattern of a sequence: "plate_%04d.png", "plate_####.exr" or "plate_*.png".
    transfer : str, optional
        Curve from code values to linear light; by default sRGB, PQ or HLG where the file is tagged so, and none for EXR
        and HDR pictures.
    primaries : str, optional
        Primaries of the plate's light; by default those of its matrix.
    eye : {"left", "right", "both"}, optional
        Eye of a stereo plate; with "both" frames are the left eye's and have the right one.
    frame_rate : Fraction or float
        Frames a second of pictures, which have no rate of their own.
    equirectangular : bool
        Refuse what is not a panorama, of 2:1 or tagged as one.
    depth : bool
        Read EXR pictures by their channel Z if they have one.
    matte : bool
        Read pictures by their alpha if it is not opaque, in all three channels.
    damaged : {"stop", "hold"}
        Raise at a frame of a video that cannot be decoded, or repeat the last one that could.
    projection : {"auto", "equirectangular", "dual_fisheye", "eac"}
        Projection of the file's pictures, whose frames are turned to equirectangular; "auto": .insv and .osv are dual
        fisheye, .360 is EAC, all else equirectangular.
    fisheye_fov_deg : float
        Angle [deg] across one half of a dual-fisheye frame.
    layout : str, optional
        Arrangement of the eyes in a file without tags; by default as its tags or its shape say.
    decoder : {"software", "auto"}
        What decodes a video: FFmpeg in software, or a graphics card if its first picture is the same, bit for bit; a
        note of the reader says which.

    Returns
    -------
    VideoReader
        An open clip; `frames(start, stop)` yields frames with `image_linear`, `time_s` and `index`.

    Raises
    ------
    VideoError
        If the plate cannot be used.

    See Also
    --------
    uw.video.create_video : Begins an output with the plate's properties.
    uw.video.transcode : Decodes and encodes a plate in one call.

    Examples
    --------
    >>> with uw.open_video("dive.mp4") as video:
    ...     frame = next(video.frames(1))
    >>> frame.index, frame.image_linear.shape
    (1, (32, 64, 3))
    """
    path = file_path("video", path)
    kind = projection_of(path, projection) if equirectangular else "equirectangular"
    if kind != "equirectangular":
        if eye is not None:
            raise VideoError(f"{path} - {kind} has no {eye} eye - leave out the eye")
        return _open_unwrapped(Path(path), kind, fisheye_fov_deg, (transfer, primaries), damaged, decoder)
    files = picture_files(Path(path))
    if files is not None:
        rate = checked_rate(frame_rate, Path(path))
        wanted: Wanted = "depth" if depth else "matte" if matte else "colour"
        return ImageReader(Path(path), files, rate, (transfer, primaries), (eye, layout), equirectangular, wanted)
    return ContainerReader(Path(path), (transfer, primaries), (eye, layout), equirectangular, damaged, decoder=decoder)


@checked
def create_video(
    path: str | Path,
    like: Clip | None = None,
    settings: EncodeSettings | None = None,
    *,
    width: int | None = None,
    height: int | None = None,
    frame_rate: Fraction | float = 30,
    sound: str | Path | None = None,
    overwrite: bool = False,
    audio: bool = True,
    rebase: bool = True,
    frames: tuple[int, int] | None = None,
) -> VideoWriter:
    """Begin an output with the size, colours, time stamps, sound and metadata of a plate, or a new one.

    A video appears under its name when it is finished, as by the end of a `with` block; an error inside leaves none.

    Parameters
    ----------
    path : str or Path
        A video .mp4, .mov, .mkv or .webm; or a picture or a pattern of pictures ("out_%04d.png", "out_####.exr"),
        numbered as the plate's files are, or else by the frame's index.
    like : Clip, optional
        The plate; without one, width, height, frame_rate and sound say what is made, in BT.709, 4:2:0, 8 bits.
    settings : EncodeSettings, optional
        Codec, quality and layout; unset values follow the plate.
    width, height : int, optional
        Size in pixels, without a plate.
    frame_rate : Fraction or float
        Frames a second, without a plate.
    sound : str or Path, optional
        File whose sound is copied, without a plate.
    overwrite : bool
        Replace an output that is there.
    audio : bool
        Copy the sound, unless the settings leave it out.
    rebase : bool
        When the first frame is not frame 0 of the plate, move pictures and sound so that the output begins where the
        plate begins; False keeps the time stamps.
    frames : tuple of int, optional
        Frames (start, stop) that will be written, which time code and chapters follow; by default all.

    Returns
    -------
    VideoWriter
        An open output that takes frames.

    Raises
    ------
    OutputExistsError
        If the output is there already and `overwrite` is not set.
    OutputError
        If it may not be written.
    VideoError
        If it cannot be made.

    See Also
    --------
    uw.open_video : Opens the plate.
    uw.video.transcode : Decodes and encodes a plate in one call.
    uw.composite_video : Makes a composite and writes it.

    Examples
    --------
    >>> with uw.open_video("dive.mp4") as video, uw.video.create_video("copy.mp4", video) as copy:
    ...     for frame in video.frames():
    ...         copy.write(frame)
    """
    path = Path(path)
    if like is None:
        if width is None or height is None:
            raise VideoError(f"{path} - the size of a new video is missing - give like, or width and height")
        like = _new_clip(path, width, height, frame_rate, sound)
    check_outputs([path], inputs=[like.path] if like.path.name else [], overwrite=overwrite)
    if path.suffix.lower() in PICTURE_SUFFIXES:
        return ImageWriter(path, like, overwrite)
    from mr360uw.video.container_writer import ContainerWriter

    settings = settings or EncodeSettings()
    settings = settings if audio else settings.model_copy(update={"sound": False})
    return ContainerWriter(path, like, settings, rebase=rebase, overwrite=overwrite, frames=frames)


def _new_clip(path: Path, width: int, height: int, frame_rate: Fraction | float, sound: str | Path | None) -> Clip:
    if width != 2 * height or height < 2 or height % 2:
        raise VideoError(
            f"{path} - a panorama must be 2:1 with an even height (got {width}x{height}) - take 2048x1024 or 3840x1920"
        )
    rate, audio = checked_rate(frame_rate, path), Path(sound) if sound is not None else None
    return Clip(path=Path(), width=width, height=height, frame_rate=rate, time_base=1 / rate, sound=audio)


@checked
def transcode(
    source: str | Path,
    target: str | Path,
    settings: EncodeSettings | None = None,
    *,
    start: int = 0,
    stop: int | None = None,
    overwrite: bool = False,
    equirectangular: bool = True,
) -> int:
    """Decode and encode the frames start <= index < stop of a plate, with sound; returns their number."""
    count = 0
    with open_video(source, equirectangular=equirectangular) as video:
        frames = video.frames(start, stop)
        span = video.check_range(start, stop)
        with create_video(target, video, settings, overwrite=overwrite, frames=span) as out:
            for frame in frames:
                out.write(frame)
                count += 1
    return count


# Plates in other projections, read as equirectangular frames through FFmpeg's filter v360.
#
# Dual fisheye: two circles side by side in one frame, in two tracks, or in two files (Insta360's _00_ and _10_). EAC
# (equi-angular cubemap): six cube faces in two rows of three, in one frame, or one row in each of GoPro's two tracks.
# v360 samples each frame by itself, so that a frame depends on its own pictures alone.


def _open_unwrapped(
    path: Path,
    projection: Projection,
    fov_deg: float,
    named: NamedColors,
    damaged: Damaged,
    decoder: Decoder,
) -> VideoReader:
    """Open a video in a projection other than equirectangular; raise `VideoError`.

    fov_deg: angle across one half of a dual-fisheye frame.
    """
    # Refuse pictures, which are not turned
    if path.suffix.lower() in PICTURE_SUFFIXES:
        raise VideoError(
            f"{path} - pictures are read as equirectangular only (got {projection}) - turn them by "
            + turned_by_ffmpeg(path, projection)
        )
    # Find the second lens: in another track, or in another file
    sizes = track_sizes(path)
    width, height = sizes[0]
    paths = [(path, 0)]
    if len(sizes) > 1 and sizes[1] == sizes[0]:
        paths.append((path, 1))
    elif projection == "dual_fisheye" and width == height and (other := second_lens(path)) is not None:
        paths.append((other, 0))
    # Check that the pictures have the shape of their projection
    if projection == "eac" and len(paths) < 2 and not 1.4 < width / height < 1.8:
        raise VideoError(
            f"{path} - EAC is two tracks of three cube faces, or one frame of 3:2 to 16:9 (got one of "
            f"{width}x{height}) - give the camera's .360 file with both tracks, or export it as equirectangular 2:1 in "
            "GoPro Player"
        )
    if projection != "eac" and len(paths) * width != 2 * height:
        raise VideoError(
            f"{path} - two fisheye circles side by side make a frame of 2:1 (got {width}x{height}"
            f"{'' if len(paths) == 1 else ', twice'}) - crop it to the circles, give both of the camera's files "
            "(_00_ and _10_) their names again, or export it as equirectangular 2:1"
        )
    tracks = [
        ContainerReader(p, named, equirectangular=False, damaged=damaged, track=k, decoder=decoder) for p, k in paths
    ]
    return _UnwrappedReader(tracks, projection, fov_deg)


class _UnwrappedReader(ReaderOver):
    """The frames of one or two tracks, joined and turned to equirectangular. Index and time stamps are the first's."""

    def __init__(self, tracks: list[ContainerReader], projection: Projection, fov_deg: float) -> None:
        first = tracks[0]
        height = first.height if projection == "dual_fisheye" else 2 * first.height // (3 - len(tracks))
        height -= height % 2
        note = f"{first.path} - {projection} is turned to equirectangular by FFmpeg's v360"
        note += f", {fov_deg:g} degrees across a circle" if projection == "dual_fisheye" else ""
        note += "; the camera maker's program stitches better, above all what is near"
        super().__init__(
            first, width=2 * height, height=height, spherical=None, panorama=True, pixel_aspect=Fraction(0),
            notes=(*first.notes, note),
        )  # fmt: skip
        self._tracks, self._projection, self._fov_deg = tracks, projection, fov_deg

    @property
    def frame_count(self) -> int:
        """Number of frames that all tracks have."""
        return min(track.frame_count for track in self._tracks)

    @property
    def intact_frames(self) -> int:
        """Number of frames whose data are there; see `VideoReader`."""
        return min(track.intact_frames for track in self._tracks)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Notes on signs that the plate is not all there."""
        counts = [track.frame_count for track in self._tracks]
        uneven = f"{self.path} - its two lenses have unequal numbers of frames (got {counts}): is it cut short?"
        return tuple(dict.fromkeys(d for track in self._tracks for d in track.doubts)) + (
            (uneven,) if min(counts) < max(counts) else ()
        )

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; see `VideoReader`."""
        start, stop = self._tracks[0].check_range(start, stop if stop is not None else self.frame_count)
        for track in self._tracks[1:]:
            track.check_range(start, stop)
        return start, stop

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; see `VideoReader`."""
        start, stop = self.check_range(start, stop)
        return self._turned([track.frames(start, stop) for track in self._tracks], self._filter())

    @contextmanager
    def seeker(self) -> Iterator[Seeker]:
        """Yield a function of a start that reads on from there in open files; see `VideoReader`."""
        turn = self._filter()
        with ExitStack() as opened:
            seekers = [opened.enter_context(track.seeker()) for track in self._tracks]
            yield lambda start: self._turned([seek(start) for seek in seekers], turn)

    def _turned(self, tracks: list[Iterator[VideoFrame]], turn: Callable[[Any], Any]) -> Iterator[VideoFrame]:
        for pictures in zip(*tracks, strict=False):  # a seeker's tracks may differ in length
            first = pictures[0]
            out = turn(native_frame(self._joined([_planes(p) for p in pictures])))
            planes = plane_views(out, self.spec, locked=True)
            damage = next((p.damage for p in pictures if p.damage != "none"), "none")
            yield replace(first, yuv=planes, native=None, wrap=True, damage=damage)

    def _joined(self, images: list[YuvImage]) -> YuvImage:
        """Return one picture of all tracks: circles side by side, or rows of cube faces below each other."""
        if len(images) == 1:
            return images[0]
        size = images[0].y.shape[1], images[0].y.shape[0]

        def both(planes: list[NDArray[Any]]) -> NDArray[Any]:
            if self._projection == "eac":
                return np.concatenate([joined_row(plane, size) for plane in planes], axis=0)
            return np.concatenate(planes, axis=1)

        y, u, v = (both([getattr(image, name) for image in images]) for name in ("y", "u", "v"))
        return YuvImage(y, u, v, self.spec)

    def _filter(self) -> Callable[[Any], Any]:
        """Return a function that turns a picture of the tracks, as PyAV's frame, to equirectangular."""
        graph: list[Any] = []
        options = f"{FFMPEG_NAMES[self._projection]}:e:cubic:w={self.width}:h={self.height}"
        if self._projection == "dual_fisheye":
            options += f":ih_fov={self._fov_deg:g}:iv_fov={self._fov_deg:g}"

        def turn(native: Any) -> Any:
            if not graph:
                made = av.filter.Graph()
                source = made.add_buffer(
                    width=native.width, height=native.height, format=native.format, time_base=self.time_base
                )
                ends = (source, made.add("v360", options), made.add("buffersink"))
                made.link_nodes(*ends).configure()
                graph.append(made)
            native.pts, native.time_base = 0, self.time_base
            graph[0].push(native)
            return graph[0].pull()

        return turn


def _planes(frame: VideoFrame) -> YuvImage:
    assert frame.yuv is not None  # videos have planes
    return frame.yuv
