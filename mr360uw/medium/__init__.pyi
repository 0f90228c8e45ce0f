from .closed_form import multiple_scattering
from .layers import LayeredField
from .lookup import compress_gamut
from .medium import MODES, Medium
from .models import spectral_model
from .open_water import PlateProfile
from .phase import PhaseTable
from .ray_field import LambertFloor
from .settings import WaterSettings
from .shafts.shaft_field import FroxelGrid, ShaftField, shaft_deviation, shaft_field
from .shafts.shaft_scene import ShaftScene
from .shafts.single_scattering import single_scattering
from .spectra import Sensor, cameras, illuminant, reflectance
from .transfer import LightField
from .veil_gain import exposure_change, fit_gain, picture_change, steady_gain
from .water import JERLOV_TYPES, Water
from .water_by_distance import WaterByDistance
from .waterfit import WaterFit, fit_water
from .wavelengths import Bands, bands

__all__ = [
    "JERLOV_TYPES",
    "MODES",
    "Bands",
    "FroxelGrid",
    "LambertFloor",
    "LayeredField",
    "LightField",
    "Medium",
    "PhaseTable",
    "PlateProfile",
    "Sensor",
    "ShaftField",
    "ShaftScene",
    "Water",
    "WaterByDistance",
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
    "shaft_deviation",
    "shaft_field",
    "single_scattering",
    "spectral_model",
    "steady_gain",
]
