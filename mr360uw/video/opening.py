# SPDX-License-Identifier: Apache-2.0
"""Opens plates and begins outputs of every kind: video files, sequences of pictures, single pictures."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

from mr360uw.color import Primaries, Transfer
from mr360uw.errors import VideoError
from mr360uw.output_gate import check_outputs
from mr360uw.shapes import checked, file_path
from mr360uw.video.clip import Clip, checked_rate
from mr360uw.video.exr import Wanted
from mr360uw.video.formats import FISHEYE_FOV_DEG, PICTURE_SUFFIXES, EncodeSettings, Projection, projection_of
from mr360uw.video.image_writer import ImageWriter
from mr360uw.video.images import ImageReader, picture_files
from mr360uw.video.layout import Eye, Layout
from mr360uw.video.reader import Damaged, Decoder, VideoReader
from mr360uw.video.writer import VideoWriter


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
        from mr360uw.video.unwrapped import open_unwrapped

        if eye is not None:
            raise VideoError(f"{path} - {kind} has no {eye} eye - leave out the eye")
        return open_unwrapped(Path(path), kind, fisheye_fov_deg, transfer, primaries, damaged, decoder)
    files = picture_files(Path(path))
    if files is not None:
        rate = checked_rate(frame_rate, Path(path))
        wanted: Wanted = "depth" if depth else "matte" if matte else "colour"
        return ImageReader(Path(path), files, rate, transfer, primaries, eye, equirectangular, wanted, layout)
    from mr360uw.video.container import ContainerReader

    return ContainerReader(Path(path), transfer, primaries, eye, equirectangular, damaged, layout, decoder=decoder)


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
    rate = checked_rate(frame_rate, path)
    return Clip(
        path=Path(),
        width=width,
        height=height,
        frame_rate=rate,
        time_base=1 / rate,
        sound=Path(sound) if sound is not None else None,
    )


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
