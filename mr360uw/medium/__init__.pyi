from .closed_form import multiple_scattering
from .fit.exposure import exposure_change, fit_gain, picture_change, steady_gain
from .fit.profile import PlateProfile
from .fit.waterfit import WaterFit, fit_water
from .jerlov import JERLOV_TYPES
from .medium import MODES, Medium
from .models import spectral_model
from .settings import WaterSettings
from .spectral.bands import Bands, bands
from .spectral.gamut import compress_gamut
from .spectral.sensor import Sensor, cameras, illuminant
from .spectral.upsampling import reflectance
from .transfer import LightField
from .water import Water

__all__ = [
    "JERLOV_TYPES",
    "MODES",
    "Bands",
    "LightField",
    "Medium",
    "PlateProfile",
    "Sensor",
    "Water",
    "WaterFit",
    "WaterSettings",
    "bands",
    "cameras",
    "compress_gamut",
    "exposure_change",
    "fit_gain",
    "fit_water",
    "illuminant",
    "multiple_scattering",
    "picture_change",
    "reflectance",
    "spectral_model",
    "steady_gain",
]
