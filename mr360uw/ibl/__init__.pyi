from .filters import glossy_beam, irradiance, prefilter, split_sum
from .lighting import environment, environment_from_yuv
from .plate import expand
from .settings import LightSettings
from .sun.detect import detect_sun
from .sun.track import SunMeasurement, SunTrack, load_track, measure_sun, save_track, track_suns

__all__ = [
    "LightSettings",
    "SunMeasurement",
    "SunTrack",
    "detect_sun",
    "environment",
    "environment_from_yuv",
    "expand",
    "glossy_beam",
    "irradiance",
    "load_track",
    "measure_sun",
    "prefilter",
    "save_track",
    "split_sum",
    "track_suns",
]
