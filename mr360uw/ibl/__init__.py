# SPDX-License-Identifier: Apache-2.0
"""Light from the plate: expansion to scene radiance, environment maps, the sun.

environment, environment_from_yuv   radiance, irradiance, glossy levels, sun and residual of one frame
expand                              inverse tone mapping of a whole plate
detect_sun                          the sun, clipped or not
irradiance, prefilter, split_sum    the integrals themselves
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mr360uw.ibl.cosine import irradiance as irradiance
    from mr360uw.ibl.expansion import expand as expand
    from mr360uw.ibl.glossy import glossy_beam as glossy_beam
    from mr360uw.ibl.glossy import prefilter as prefilter
    from mr360uw.ibl.lighting import environment as environment
    from mr360uw.ibl.settings import LightSettings as LightSettings
    from mr360uw.ibl.splitsum import split_sum as split_sum
    from mr360uw.ibl.sun import detect_sun as detect_sun
    from mr360uw.ibl.track import SunMeasurement as SunMeasurement
    from mr360uw.ibl.track import SunTrack as SunTrack
    from mr360uw.ibl.track import measure_sun as measure_sun
    from mr360uw.ibl.track import track_suns as track_suns
    from mr360uw.ibl.trackfile import load_track as load_track
    from mr360uw.ibl.trackfile import save_track as save_track
    from mr360uw.ibl.yuv import environment_from_yuv as environment_from_yuv

_HOME = {
    "LightSettings": "settings",
    "detect_sun": "sun",
    "environment": "lighting",
    "environment_from_yuv": "yuv",
    "expand": "expansion",
    "glossy_beam": "glossy",
    "irradiance": "cosine",
    "prefilter": "glossy",
    "split_sum": "splitsum",
    "SunMeasurement": "track",
    "SunTrack": "track",
    "load_track": "trackfile",
    "measure_sun": "track",
    "save_track": "trackfile",
    "track_suns": "track",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
