# SPDX-License-Identifier: Apache-2.0
"""Formats: codecs and the `[output]` table of a scene; endings of files and projections of plates."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mr360uw.parameters import Parameters, advanced, parameter
from mr360uw.reading.input_files import not_read

Codec = Literal["auto", "h264", "h265", "av1", "ffv1", "prores"]
Preset = Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow"]

ENCODERS: dict[Codec, str] = {
    "h264": "libx264", "h265": "libx265", "av1": "libsvtav1", "ffv1": "ffv1", "prores": "prores"
}  # fmt: skip
Encoder = Literal[
    "software", "auto", "h264_nvenc", "hevc_nvenc", "av1_nvenc", "h264_qsv", "hevc_qsv", "av1_qsv", "h264_amf",
    "hevc_amf", "av1_amf", "h264_vaapi", "hevc_vaapi", "av1_vaapi", "h264_videotoolbox", "hevc_videotoolbox",
]  # fmt: skip
_FAMILIES: dict[str, Codec] = {"h264": "h264", "hevc": "h265", "av1": "av1"}
HARDWARE: dict[Encoder, Codec] = {
    name: _FAMILIES[name.partition("_")[0]] for name in get_args(Encoder) if name not in ("software", "auto")
}
"""FFmpeg's encoders of graphics cards, and what they encode."""
# SVT-AV1 counts its presets the other way; above 10 it is made for tests of tools.
_AV1_PRESETS: dict[Preset, int] = {preset: 10 - place for place, preset in enumerate(get_args(Preset))}


_PARAMETERS: dict[Codec, str] = {"h264": "x264-params", "h265": "x265-params", "av1": "svtav1-params"}


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
    data: bool = advanced(True, "keep the plate's tracks of data, its time code and its chapters")
    segment_s: float = parameter(
        5.0, "length of the parts that a run keeps until all are there; a killed run loses one", unit="s", low=0.01,
        high=3600.0, internal="the run",
    )  # fmt: skip

    @model_validator(mode="after")
    def _lossless_codec(self) -> Self:
        if self.quality == "lossless" and self.codec in ("av1", "prores"):
            raise ValueError(f"lossless is not available with {self.codec}; take h264, h265 or ffv1")
        return self

    @model_validator(mode="after")
    def _one_choice(self) -> Self:
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
        return ENCODERS[self.codec] if self.encoder == "software" else self.encoder

    def encoder_options(
        self, hdr: Mapping[str, str] | None = None, delivery: Mapping[str, str] | None = None
    ) -> dict[str, str]:
        """Return the options of FFmpeg's encoder.

        hdr: the clip's metadata as parameters of the codec, of software encoders. delivery: options of a target, which
        take the place of the quality.
        """
        if self.encoder != "software":
            return dict(delivery) if delivery else self._hardware_options()
        options = self._plain_options()
        if delivery:
            options.pop("crf", None)
            options |= delivery
            if self.codec == "h265":
                options["x265-params"] += ":open-gop=0"
        name = _PARAMETERS.get(self.codec)
        if hdr and name:
            written = ":".join(f"{key}={value}" for key, value in hdr.items())
            options[name] = f"{options[name]}:{written}" if name in options else written
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
        lossless, crf = self.quality == "lossless", {"crf": str(self.quality)}
        if self.codec == "h264":
            return {"preset": self.preset, **({"qp": "0"} if lossless else crf)}
        if self.codec == "h265":
            quiet = "log-level=error"
            return {
                "preset": self.preset,
                **({"x265-params": f"{quiet}:lossless=1"} if lossless else {"x265-params": quiet, **crf}),
            }
        if self.codec == "av1":
            return {"preset": str(_AV1_PRESETS[self.preset]), **crf}
        if self.codec == "ffv1":
            return {"level": "3", "slices": "16", "slicecrc": "1", "g": "1"}
        return {"profile": "3"}


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
