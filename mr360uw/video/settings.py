# SPDX-License-Identifier: Apache-2.0
"""Settings of the output's encoding: the `[output]` table of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Self, get_args

from pydantic import Field, model_validator

from mr360uw.parameters import Parameters, advanced, parameter

Codec = Literal["auto", "h264", "h265", "av1", "ffv1", "prores"]
Preset = Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow"]

ENCODERS: dict[Codec, str] = {
    "h264": "libx264",
    "h265": "libx265",
    "av1": "libsvtav1",
    "ffv1": "ffv1",
    "prores": "prores",
}
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
_AV1_PRESETS: dict[Preset, int] = {
    "ultrafast": 10, "superfast": 9, "veryfast": 8, "faster": 7, "fast": 6,
    "medium": 5, "slow": 4, "slower": 3, "veryslow": 2,
}  # fmt: skip


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
