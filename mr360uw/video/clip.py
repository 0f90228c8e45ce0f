# SPDX-License-Identifier: Apache-2.0
"""Clip metadata: size, frame rate, time base, sound, spherical metadata, colour tags, high dynamic range;
and what clips can be written as: codecs, endings of files, projections.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self, get_args

import numpy as np
from av.sidedata.sidedata import Type
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mr360uw.base.color import HDR_CURVES, ColorSpec, Matrix, Primaries, Transfer
from mr360uw.base.input_files import not_read
from mr360uw.base.parameters import Parameters, advanced, parameter
from mr360uw.errors import VideoError
from mr360uw.video.picture_tags import PictureTags
from mr360uw.video.spherical import SphericalMetadata, Stereo

_FASTEST = 1000  # frames per second, as in a scene


_KEEPING = {
    "data": "write .mp4 or .mov, which hold what FFmpeg has a name for, with output.data",
    "subtitle": "write a container like the plate's own, with output.data, or add it to the output by a muxer",
    "video": "one track of pictures is worked on: copy another one into a file of its own to work on that",
}
"""How tracks of each kind are had in an output."""


def not_copied(path: Path, kind: str, index: int, tags: Mapping[str, str]) -> str:
    """Return the note on a track of a plate that no output holds, unless its container can. tags: of the track."""
    language = tags.get("language", "und").replace("und", "")
    named = ", ".join(filter(None, [language, (tags.get("title") or tags.get("handler_name") or "").strip()]))
    about = f" ({named})" if named else ""
    return f"{path} - its {kind} track {index}{about} is not copied - {_KEEPING.get(kind, 'add it by a muxer')}"


def checked_rate(frame_rate: Fraction | float, path: Path) -> Fraction:
    """Return frames per second as a fraction of denominator 1001 or less; VideoError unless above 0, at most 1000."""
    if not 0 < frame_rate <= _FASTEST or (rate := Fraction(frame_rate).limit_denominator(1001)) <= 0:
        raise VideoError(
            f"{path} - frame rate must be above 0 and at most {_FASTEST} (got {frame_rate}) - give frames per second"
        )
    return rate


class ColorTags(NamedTuple):
    """The numbers of H.273 that a container or codec carries: range, matrix, primaries, transfer curve."""

    color_range: int
    colorspace: int
    color_primaries: int
    color_trc: int

    @classmethod
    def of(cls, native: Any) -> ColorTags:
        """Read them from a PyAV codec context or frame."""
        return cls(*(int(getattr(native, name)) for name in cls._fields))

    def write_to(self, native: Any) -> None:
        """Set them on a PyAV codec context or frame."""
        for name, number in self._asdict().items():
            setattr(native, name, number)


BT709_TAGS = ColorTags(color_range=1, colorspace=1, color_primaries=1, color_trc=1)
"""Tags of video made from stills: BT.709, limited range."""


_UNSPECIFIED = 2


@dataclass(kw_only=True, eq=False)
class Clip:
    """Metadata of a clip.

    path: the file, or the pattern of a sequence. width, height: of the panorama, after the choice of an eye.
    frame_rate: mean frames per second. time_base: unit of the time stamps. start_pts: time stamp of frame 0.
    spec: how the codes are read. tags: the file's colour tags. codec_name, pixel_format: FFmpeg's names; pixel_format
    is "" for pictures. sound: the file whose sound belongs to the clip, if any. spherical: metadata found, or None.
    is_still: one picture, that `frames` repeats as often as asked. notes: parts of the file that are not copied, one
    line each. words: text tags of the container, such as title and date. track_words: language, title and handler's
    name of the track of pictures. pixel_aspect: width of a pixel over its height as the file says, 0 where it does not.
    panorama: whether outputs are marked as full spheres. hdr: metadata of high dynamic range, where the file has some.
    stereo: arrangement of both eyes in outputs, whose frames have a right one; "mono" if they have not.
    first_number: of frame 0 in the names of a sequence's files, 0 of all else. picture_tags: metadata of the first
    picture of stills and sequences.
    """

    path: Path
    width: int
    height: int
    frame_rate: Fraction
    time_base: Fraction
    start_pts: int = 0
    spec: ColorSpec = field(default_factory=ColorSpec)
    tags: ColorTags = BT709_TAGS
    codec_name: str = ""
    pixel_format: str = ""
    sound: Path | None = None
    spherical: SphericalMetadata | None = None
    is_still: bool = False
    notes: tuple[str, ...] = ()
    words: Mapping[str, str] = field(default_factory=dict)
    track_words: Mapping[str, str] = field(default_factory=dict)
    pixel_aspect: Fraction = Fraction(0)
    panorama: bool = True
    hdr: HdrMetadata | None = None
    stereo: Stereo = "mono"
    first_number: int = 0
    picture_tags: PictureTags | None = None

    @property
    def pose_deg(self) -> tuple[float, float, float]:
        """Yaw, pitch and roll [deg] of the panorama that the file states; zeros without."""
        said = self.spherical or self.picture_tags
        return (0.0, 0.0, 0.0) if said is None else said.pose_deg

    @property
    def frame_size(self) -> tuple[int, int]:
        """Width and height [pixels] of the whole picture, of both eyes where there are two."""
        if self.stereo == "mono":
            return self.width, self.height
        return (self.width, 2 * self.height) if self.stereo == "top-bottom" else (2 * self.width, self.height)

    @property
    def frame_count(self) -> int | None:
        """Number of frames; None where it is unknown or unlimited (a still)."""
        return None


# Tags and pixel formats become a `ColorSpec`. Untagged clips are read by the usual convention: BT.709 from 720 rows up,
# BT.601 below; limited range unless the pixel format is one of the full-range `yuvj` kinds. A tagged transfer curve is
# *not* followed by default: cameras tag BT.709 and apply their own rendering for a display, so the inverse of the
# display curve (sRGB here) gives the light that a display would show; name another curve to override it. PQ and HLG are
# followed: they hold light above white.
#
# Of high dynamic range (SMPTE ST 2086, CTA-861.3) are the display that a clip was graded on, and the brightest light in
# it. FFmpeg gives them as data beside the first picture; encoders take them as text.

# Values of ITU-T H.273, as FFmpeg numbers them.
_MATRICES: dict[int, Matrix] = {1: "bt709", 5: "bt601", 6: "bt601", 9: "bt2020"}


_FULL_RANGE = 2


_HD_ROWS = 720
"""Untagged clips with at least this many rows are BT.709."""

NamedColors = tuple[Transfer | None, Primaries | None]
"""Curve and primaries of a plate that the user names; None where they follow the file."""
_PIXEL_FORMAT = re.compile(r"yuv(j?)(420|422|444)p(\d+)?(le)?$")


def color_spec(path: Path, pixel_format: str, tags: ColorTags, rows: int, named: NamedColors) -> ColorSpec:
    """Return matrix, range, curve, depth and primaries of a clip's codes; VideoError for unsupported formats."""
    transfer, primaries = named
    found = _PIXEL_FORMAT.match(pixel_format)
    if not found:
        raise VideoError(
            f"{path} - pixel format not supported (got {pixel_format}) - convert the clip to planar Y'CbCr, such as "
            "yuv420p, yuv422p10le or yuv444p"
        )
    if tags.colorspace == _UNSPECIFIED:
        matrix: Matrix = "bt709" if rows >= _HD_ROWS else "bt601"
    elif tags.colorspace in _MATRICES:
        matrix = _MATRICES[tags.colorspace]
    else:
        raise VideoError(
            f"{path} - colour matrix not supported (got H.273 matrix {tags.colorspace}) - convert the clip to BT.709"
        )
    full_range = bool(found[1]) or tags.color_range == _FULL_RANGE
    curve: Transfer = transfer or HDR_CURVES.get(tags.color_trc, "srgb")
    return ColorSpec(matrix, full_range, curve, int(found[3] or 8), primaries)


_SILENT_CURVES = frozenset({0, 1, 2, 3, 4, 5, 6, 7, 11, 12, 13, 14, 15, *HDR_CURVES})
"""Curves by their numbers in H.273: none, those of displays and cameras, read by the display's, and wide ones."""


_OTHER_PRIMARIES = {10: "XYZ", 11: "DCI P3", 12: "Display P3", 22: "EBU 3213"}
"""Primaries by their numbers there that no matrix implies. Those of standard definition nearly are Rec.709's."""


def color_notes(path: Path, tags: ColorTags, named: NamedColors) -> Iterator[str]:
    """Yield lines on colour tags of a clip that are not followed."""
    transfer, primaries = named
    if transfer is None and tags.color_trc not in _SILENT_CURVES:
        what = {8: "linear", 9: "logarithmic", 10: "logarithmic"}.get(tags.color_trc, f"number {tags.color_trc}")
        yield f"{path} - is tagged with a curve that is not used (got {what}), read as sRGB - set plate.transfer"
    if primaries is None and tags.color_primaries in _OTHER_PRIMARIES:
        yield (
            f"{path} - is tagged with primaries that are not used (got {_OTHER_PRIMARIES[tags.color_primaries]}), read "
            "as those of its matrix: colours are a little pale - convert it to BT.709 or BT.2020, or give plate.lut"
        )
    elif primaries is None and tags.color_primaries == 9 and tags.colorspace not in (2, 9, 10):
        yield f'{path} - is tagged with BT.2020 primaries and another matrix - set plate.primaries = "bt2020"'


_RATIONALS = struct.Struct("<20i2i")  # AVMasteringDisplayMetadata: ten fractions, two flags


_CONTENT = struct.Struct("<2I")  # AVContentLightMetadata


_PER_CHROMATICITY, _PER_CD_M2 = 50_000, 10_000  # units of ST 2086: 0.00002 and 0.0001 cd/m^2


MasteringDisplay = tuple[tuple[float, float], ...]
"""The display of ST 2086: chromaticities (x, y) of red, green, blue and white, (least, most) luminance [cd/m^2]."""


HdrMetadata = tuple[MasteringDisplay | None, tuple[int, int] | None]
"""Display that a clip was graded on; brightest pixel and brightest mean of a frame [cd/m^2]. None of what is not said.
"""


def hdr_from_side_data(side_data: Mapping[Type, Any]) -> HdrMetadata | None:
    """Return the HDR metadata in the side data of a decoded frame; None where there is none."""
    display = bytes(side_data.get(Type.MASTERING_DISPLAY_METADATA) or b"")
    light = bytes(side_data.get(Type.CONTENT_LIGHT_LEVEL) or b"")
    graded_on = _display(display) if len(display) >= _RATIONALS.size else None
    content = _CONTENT.unpack_from(light) if len(light) >= _CONTENT.size else None
    return None if graded_on is None and content is None else (graded_on, content)


def _display(data: bytes) -> MasteringDisplay | None:
    *terms, has_primaries, has_luminance = _RATIONALS.unpack_from(data)
    if not (has_primaries and has_luminance) or 0 in terms[1::2]:
        return None
    value = [numerator / denominator for numerator, denominator in zip(terms[::2], terms[1::2], strict=True)]
    return tuple((value[k], value[k + 1]) for k in range(0, 10, 2))


def _written(display: MasteringDisplay, *, whole: bool) -> str:
    """Return G(x,y)B(x,y)R(x,y)WP(x,y)L(most,least), in the whole units of ST 2086 or as decimals."""

    def pair(x: float, y: float, units: int) -> str:
        return f"({round(x * units)},{round(y * units)})" if whole else f"({x:.5f},{y:.5f})"

    red, green, blue, white, (least, most) = display
    places = zip("GBR", (green, blue, red), strict=True)
    colours = "".join(name + pair(*at, _PER_CHROMATICITY) for name, at in places)
    return f"{colours}WP{pair(*white, _PER_CHROMATICITY)}L{pair(most, least, _PER_CD_M2)}"


# --- What can be written --------------------------------------------------------------------------------------------

# Formats: codecs and the `[output]` table of a scene; endings of files and projections of plates.


Codec = Literal["auto", "h264", "h265", "av1", "ffv1", "prores"]
Preset = Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow"]


class CodecForm(NamedTuple):
    """How FFmpeg encodes a codec. software: its encoder, cards: how the names of those of graphics cards begin.

    options: of the encoder in software. parameters: the option that takes more of them, of encoders with a rate factor
    and presets; hdr: the names there of the display that a clip was graded on, and of its brightest light.
    """

    software: str
    options: Mapping[str, str]
    cards: str = ""
    parameters: str = ""
    hdr: tuple[str, ...] = ()


CODECS: dict[Codec, CodecForm] = {
    "h264": CodecForm("libx264", {}, "h264", "x264-params", ("mastering-display", "cll")),
    "h265": CodecForm(
        "libx265", {"x265-params": "log-level=error"}, "hevc", "x265-params", ("master-display", "max-cll")
    ),
    "av1": CodecForm("libsvtav1", {}, "av1", "svtav1-params", ("mastering-display", "content-light")),
    "ffv1": CodecForm("ffv1", {"level": "3", "slices": "16", "slicecrc": "1", "g": "1"}),
    "prores": CodecForm("prores", {"profile": "3"}),
}
CONTAINERS = {".mp4": "mp4", ".m4v": "mp4", ".mov": "mov", ".mkv": "matroska", ".webm": "webm"}
"""FFmpeg's names of the kinds of output, by suffix."""
Encoder = Literal[
    "software", "auto", "h264_nvenc", "hevc_nvenc", "av1_nvenc", "h264_qsv", "hevc_qsv", "av1_qsv", "h264_amf",
    "hevc_amf", "av1_amf", "h264_vaapi", "hevc_vaapi", "av1_vaapi", "h264_videotoolbox", "hevc_videotoolbox",
]  # fmt: skip
HARDWARE: dict[Encoder, Codec] = {
    name: codec for name in get_args(Encoder) for codec, form in CODECS.items() if name.partition("_")[0] == form.cards
}
"""FFmpeg's encoders of graphics cards, and what they encode."""
# SVT-AV1 counts its presets the other way; above 10 it is made for tests of tools.
_AV1_PRESETS: dict[Preset, int] = {preset: 10 - place for place, preset in enumerate(get_args(Preset))}


class EncodeSettings(Parameters):
    """Codec, quality and layout of a video output; unset values follow the plate."""

    codec: Codec = parameter(
        "auto", "codec of the pictures; auto: h264 of 8 bits, h265 of more, which players decode where no H.264 is"
    )
    target: Literal["none", "youtube-360", "quest"] = parameter(
        "none", "what the file is for: codec, pixel format, bit rate and key frames as that place recommends, in mp4"
    )
    encoder: Encoder = advanced(
        "software",
        "FFmpeg's encoder of a graphics card, which decides the codec; it is tried at the start. auto: the first that "
        "makes the codec here, or else software; files of different machines differ",
    )
    quality: Literal["lossless"] | Annotated[int, Field(ge=0, le=51)] = parameter(
        17, "constant rate factor, 0 the best, 51 the worst (h264, h265, av1); or lossless (h264, h265; ffv1 always is)"
    )
    preset: Preset = advanced("veryfast", "speed against size (h264, h265, av1)")
    pixel_format: str = advanced("", "FFmpeg's name, such as yuv420p10le; empty: the plate's")
    sound: bool = parameter(True, "copy the plate's sound")
    layers: Literal["rec709", "ap0", "ap1", "rec2020", "p3d65"] = advanced(
        "rec709", "primaries of the linear light in `--layers`; ap1: ACEScg, ap0: ACES2065-1"
    )
    data: bool = advanced(True, "keep the plate's tracks of data, its time code and its chapters")
    segment_s: float = parameter(
        5.0, "length of the parts that a run keeps until all are there; a killed run loses one", unit="s", low=0.01,
        high=3600.0, internal="the run",
    )  # fmt: skip

    @model_validator(mode="after")
    def _one_choice(self) -> Self:
        if self.quality == "lossless" and self.codec in ("av1", "prores"):
            raise ValueError(f"lossless is not available with {self.codec}; take h264, h265 or ffv1")
        if self.quality == "lossless" and self.encoder != "software":
            raise ValueError(f"lossless is not available with {self.encoder}; take the encoder software")
        decided = ("codec", "pixel_format", "quality")
        named = [name for name in decided if getattr(self, name) != _default(name)]
        if self.target != "none" and named:
            raise ValueError(
                f"target - decides {' and '.join(named)} (got {self.target!r} beside) - leave out one or the other"
            )
        if self.encoder != "software" and self.preset != _default("preset"):
            raise ValueError(
                f"preset - is of software encoders, {self.encoder} has none (got {self.preset!r}) - leave it out"
            )
        if self.encoder in HARDWARE and self.codec not in ("auto", HARDWARE[self.encoder]):
            raise ValueError(
                f"encoder {self.encoder} makes {HARDWARE[self.encoder]}, not {self.codec}; leave out codec"
            )
        return self

    @property
    def encoder_name(self) -> str:
        """FFmpeg's name of the encoder, of a codec that is resolved."""
        return CODECS[self.codec].software if self.encoder == "software" else self.encoder

    def encoder_options(
        self, hdr: HdrMetadata | None = None, delivery: Mapping[str, str] | None = None
    ) -> dict[str, str]:
        """Return the options of FFmpeg's encoder.

        hdr: of the clip, which encoders in software write. delivery: options of a target, which take the place of the
        quality.
        """
        if self.encoder != "software":
            return dict(delivery) if delivery else self._hardware_options()
        form, options = CODECS[self.codec], self._plain_options()
        if delivery:
            options.pop("crf", None)
            options |= delivery
            if self.codec == "h265":
                options["x265-params"] += ":open-gop=0"
        # Append the display and the brightest light to the parameters
        display, content = hdr or (None, None)
        values = (
            "" if display is None else _written(display, whole=self.codec != "av1"),
            "" if content is None else f"{content[0]},{content[1]}",
        )
        said = [f"{name}={value}" for name, value in zip(form.hdr, values, strict=False) if value]
        if said:
            options[form.parameters] = ":".join(filter(None, [options.get(form.parameters, ""), *said]))
        return options

    def _hardware_options(self) -> dict[str, str]:
        """Return what means a constant quality to the encoder of a card; 0 best, as in software."""
        assert self.quality != "lossless"
        quality = str(self.quality)
        return {
            "nvenc": {"rc": "vbr", "cq": quality, "b": "0"},
            "qsv": {"global_quality": quality},
            "amf": {"rc": "cqp", "qp_i": quality, "qp_p": quality},
            "vaapi": {"rc_mode": "CQP", "qp": quality},
            # FF_QP2LAMBDA is 118; its quality rises from 0 to 100
            "videotoolbox": {"global_quality": str(118 * (100 - 2 * min(self.quality, 49))), "flags": "+qscale"},
        }[self.encoder.partition("_")[2]]

    def _plain_options(self) -> dict[str, str]:
        form = CODECS[self.codec]
        options = dict(form.options)
        if not form.parameters:
            return options
        options["preset"] = str(_AV1_PRESETS[self.preset]) if self.codec == "av1" else self.preset
        if self.quality != "lossless":
            options["crf"] = str(self.quality)
        elif self.codec == "h264":
            options["qp"] = "0"
        else:
            options["x265-params"] += ":lossless=1"
        return options


def _default(name: str) -> object:
    return EncodeSettings.model_fields[name].default


# A track of GoPro's 360 cameras is a row of three faces. The middle face is seen by one lens. The seam between the
# lenses runs through the middle of each outer face, which stores the strip about it twice, side by side; they are
# blended into one. Widths of the strip: Bourke 2020.

_INTEGER_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
FLOAT_SUFFIXES = (".exr", ".hdr")
WRITTEN_SUFFIXES = _INTEGER_SUFFIXES + FLOAT_SUFFIXES
_READ_SUFFIXES = (".insp", ".dpx", ".tga", ".jp2", ".j2k", ".avif", ".jpe", ".jfif", ".dib", ".heic", ".heif",
                  ".pic", ".rgbe", ".xyze")  # fmt: skip
PICTURE_SUFFIXES = (*WRITTEN_SUFFIXES, *_READ_SUFFIXES, *not_read("raw picture"), *not_read("picture"))
"""Endings of pictures: those that are read and written, that are read alone, and two groups that are not read."""


Projection = Literal["auto", "equirectangular", "dual_fisheye", "eac"]
"""How a plate's pixels are rays; auto: by the end of its name, else equirectangular."""

FISHEYE_FOV_DEG = 200.0
"""Angle [deg] across one half of a dual-fisheye frame where none is given. Cameras for 360 video have 189 to 205.
Given too small, what is near the seam is seen twice; too large, it is missing."""
FFMPEG_NAMES = {"dual_fisheye": "dfisheye", "eac": "eac"}
"""Names of projections in FFmpeg's filter v360."""
_BY_SUFFIX: dict[str, Projection] = {
    ".insv": "dual_fisheye", ".insp": "dual_fisheye", ".osv": "dual_fisheye", ".360": "eac"
}  # fmt: skip


def projection_of(path: Path, projection: Projection) -> Projection:
    """Return the projection of a plate, with "auto" replaced by that of the file's ending."""
    return _BY_SUFFIX.get(path.suffix.lower(), "equirectangular") if projection == "auto" else projection


def second_lens(path: Path) -> Path | None:
    """Return the file of the other lens of a camera that writes one for each, if it is there."""
    other = path.with_name(path.name.replace("_00_", "_10_", 1))
    return other if other != path and other.exists() else None


def turned_by_ffmpeg(path: Path, projection: Projection) -> str:
    """Return the command that turns a still of a projection other than equirectangular, for messages."""
    angle = f":ih_fov={FISHEYE_FOV_DEG:g}:iv_fov={FISHEYE_FOV_DEG:g}" if projection == "dual_fisheye" else ""
    return f"ffmpeg -i {path.name} -vf v360={FFMPEG_NAMES[projection]}:e{angle} out.png"


DOUBLED_STRIP = {(4096, 1344): 64, (2272, 736): 32}
"""Columns of the strip that an outer face stores twice, for the (columns, rows) of a track. Others: what is left of
three square faces."""


def joined_row(plane: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return three square faces (h, 3 h) of a plane (h, w) of a track whose luma has `size`, (columns, rows).

    Faces of exactly 3:1 have no doubled strip, and are returned as they are.
    """
    import cv2

    height, columns = plane.shape
    across = columns / size[0]
    overlap = round(across * DOUBLED_STRIP.get(size, (size[0] - 3 * size[1]) // 2))
    middle = round(across * size[1])
    outer = (columns - middle) // 2
    if overlap <= 0:
        return plane
    weight = ((np.arange(overlap) + 0.5) / overlap).astype(np.float32)
    faces = [plane[:, outer : outer + middle]]
    for side in (plane[:, :outer], plane[:, outer + middle :]):
        seam = outer // 2
        left, right = side[:, seam - overlap : seam], side[:, seam : seam + overlap]
        blend = np.rint(left * (1.0 - weight) + right * weight).astype(plane.dtype)
        face = np.concatenate([side[:, : seam - overlap], blend, side[:, seam + overlap :]], axis=1)
        faces.append(np.asarray(cv2.resize(face, (middle, height), interpolation=cv2.INTER_LINEAR)))
    return np.concatenate([faces[1], faces[0], faces[2]], axis=1)
