# SPDX-License-Identifier: Apache-2.0
"""Settings of the output's encoding: the `[output]` table of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Self

from pydantic import model_validator

from mr360uw.parameters import Parameters, parameter

Codec = Literal["h264", "h265", "av1", "ffv1", "prores"]
Preset = Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow"]

ENCODERS: dict[Codec, str] = {
    "h264": "libx264",
    "h265": "libx265",
    "av1": "libsvtav1",
    "ffv1": "ffv1",
    "prores": "prores",
}
# SVT-AV1 counts its presets the other way; above 10 it is made for tests of tools.
_AV1_PRESETS: dict[Preset, int] = {
    "ultrafast": 10, "superfast": 9, "veryfast": 8, "faster": 7, "fast": 6,
    "medium": 5, "slow": 4, "slower": 3, "veryslow": 2,
}  # fmt: skip


_PARAMETERS: dict[Codec, str] = {"h264": "x264-params", "h265": "x265-params", "av1": "svtav1-params"}


class EncodeSettings(Parameters):
    """Codec, quality and layout of a video output; unset values follow the plate."""

    codec: Codec = parameter("h264", "codec of the pictures")
    quality: int = parameter(17, "constant rate factor, smaller is better (h264, h265, av1)", low=0, high=51)
    preset: Preset = parameter("veryfast", "speed against size (h264, h265, av1)")
    lossless: bool = parameter(False, "keep every code value (h264, h265; ffv1 always does)")
    pixel_format: str = parameter("", "FFmpeg's name, such as yuv420p10le; empty: the plate's")
    sound: bool = parameter(True, "copy the plate's sound")
    data: bool = parameter(True, "keep the plate's tracks of data, its time code and its chapters")
    threads: int = parameter(0, "encoder threads, 0 for one per core", low=0, high=256)
    segment_s: float = parameter(
        5.0, "length of the parts that a run keeps until all are there; a killed run loses one", unit="s", low=0.01,
        high=3600.0,
    )  # fmt: skip
    faststart: bool = parameter(True, "put the index of an mp4 or mov before the pictures, for the web")

    @model_validator(mode="after")
    def _lossless_codec(self) -> Self:
        if self.lossless and self.codec in ("av1", "prores"):
            raise ValueError(f"lossless is not available with {self.codec}; take h264, h265 or ffv1")
        return self

    def encoder_options(self, hdr: Mapping[str, str] | None = None) -> dict[str, str]:
        """Return the options of FFmpeg's encoder; hdr: the clip's metadata as parameters of the codec."""
        options = self._plain_options()
        name = _PARAMETERS.get(self.codec)
        if hdr and name:
            written = ":".join(f"{key}={value}" for key, value in hdr.items())
            options[name] = f"{options[name]}:{written}" if name in options else written
        return options

    def _plain_options(self) -> dict[str, str]:
        crf = {"crf": str(self.quality)}
        if self.codec == "h264":
            return {"preset": self.preset, **({"qp": "0"} if self.lossless else crf)}
        if self.codec == "h265":
            quiet = "log-level=error"
            return {
                "preset": self.preset,
                **({"x265-params": f"{quiet}:lossless=1"} if self.lossless else {"x265-params": quiet, **crf}),
            }
        if self.codec == "av1":
            return {"preset": str(_AV1_PRESETS[self.preset]), **crf}
        if self.codec == "ffv1":
            return {"level": "3", "slices": "16", "slicecrc": "1", "g": "1"}
        return {"profile": "3"}
