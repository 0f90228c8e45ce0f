# SPDX-License-Identifier: Apache-2.0
"""Shapes at the calls of `mr360uw.medium`."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw import medium
from mr360uw.medium import FroxelGrid, LightField, Medium, PlateProfile, Sensor, ShaftScene, Water
from mr360uw.medium.lookup import ATTENUATION_SIZE, CLOSED_VEIL_SIZE, DEPTH_SIZE, NORMALS
from mr360uw.types import Sun, View
from tests.shapes import Batch, Refused, Returns, called, check_refused, check_returned, filled, functions_of, towards

WATER = Water.jerlov("IB")
W = np.array([450.0, 550.0, 600.0, 650.0])
FIELD = LightField(filled(4), filled(4), "isotropic")
MODEL = medium.spectral_model(WATER, W, "kd")
MEDIUM = Medium(WATER, mode="kd", band_count=4)
BANDS = medium.bands(4)
VIEW, SUN = View(4, 2), Sun(np.array([0.6, 0.8, 0.0]), np.ones(3), 0.0, 1.0)
GRID = FroxelGrid(2, 4, 3)
SCENE = ShaftScene.of(VIEW, MEDIUM, [SUN], [np.eye(3)[None]])


def radiance_map(height: int = 32, width: int = 64, channels: int = 3) -> np.ndarray:
    up = np.linspace(1.0, -1.0, height)[:, None, None]
    return np.broadcast_to(np.exp(up) * [0.1, 0.3, 0.4, 1.0][:channels], (height, width, channels))


def spectra(batch: Batch) -> Batch:
    return (*batch, 4)


def colours(batch: Batch) -> Batch:
    return (*batch, 3)


RETURNS: Returns = {
    "multiple_scattering": (lambda b: medium.multiple_scattering(WATER, W, filled(*b), 5.0, 0.2, filled(4)), spectra),
    "Water.absorption": (lambda b: WATER.absorption(filled(*b, value=500.0)), lambda b: b),
    "Water.scattering": (lambda b: WATER.scattering(filled(*b, value=500.0)), lambda b: b),
    "Water.attenuation": (lambda b: WATER.attenuation(filled(*b, value=500.0)), lambda b: b),
    "Water.backscattering": (lambda b: WATER.backscattering(filled(*b, value=500.0)), lambda b: b),
    "Water.diffuse_attenuation": (lambda b: WATER.diffuse_attenuation(filled(*b, value=500.0)), lambda b: b),
    "Water.moments": (lambda _: WATER.moments(W, 9), lambda _: (4, 9)),
    "LightField.inscatter": (lambda b: FIELD.inscatter(filled(*b), 5.0, 0.2), spectra),
    "LightField.radiance": (lambda b: FIELD.radiance(5.0, filled(*b)), spectra),
    "LightField.irradiance": (lambda b: FIELD.irradiance(filled(*b), 1.0), spectra),
    "LightField.scalar_irradiance": (lambda b: FIELD.scalar_irradiance(filled(*b)), spectra),
    "spectral_model": (lambda b: MODEL.inscatter(filled(*b), 5.0, 0.2), spectra),
    "spectral_model, light": (lambda b: MODEL.irradiance(filled(*b), 1.0), spectra),
    "Medium.transmittance": (lambda b: MEDIUM.transmittance(filled(*b), 5.0, 0.2), colours),
    "Medium.veil": (lambda b: MEDIUM.veil(3.0, filled(*b), 0.2), colours),
    "Medium.radiance": (lambda b: MEDIUM.radiance(5.0, filled(*b)), colours),
    "Medium.irradiance": (lambda b: MEDIUM.irradiance(filled(*b), 1.0), colours),
    "Medium.spectral_veil": (lambda b: MEDIUM.spectral_veil(filled(*b), 5.0, 0.2), spectra),
    "Medium.spectral_transmittance": (lambda b: MEDIUM.spectral_transmittance(filled(*b)), spectra),
    "Medium.table": (
        lambda _: MEDIUM.table,
        lambda _: {"veil": (*CLOSED_VEIL_SIZE, 3), "attenuation": (*ATTENUATION_SIZE, 3)}
        | dict.fromkeys(("beam", "unscattered"), (DEPTH_SIZE, 3))
        | {"diffuse": (NORMALS, DEPTH_SIZE, 3)},
    ),
    "bands": (lambda _: BANDS, lambda _: {"wavelength_nm": (4,), "weight": (4, 3)}),
    "Bands.rgb": (lambda b: BANDS.rgb(filled(*b, 4)), colours),
    "Bands.log_light": (lambda b: BANDS.log_light(filled(*b, 4)), colours),
    "Sensor.response": (lambda b: Sensor.cie1931().response(filled(*b, value=500.0)), colours),
    "illuminant": (lambda b: medium.illuminant("D65")(filled(*b, value=500.0)), lambda b: b),
    "reflectance": (lambda b: medium.reflectance(filled(*b, 3), W), spectra),
    "compress_gamut": (lambda b: medium.compress_gamut(filled(*b, 3)), colours),
    "PlateProfile.from_map": (
        lambda _: PlateProfile.from_map(radiance_map()),
        lambda _: {"up": (32,), "radiance": (32, 3)},
    ),
    "PlateProfile": (lambda b: PlateProfile.from_map(radiance_map())(filled(*b)), colours),
    "fit_gain": (lambda _: medium.fit_gain(MEDIUM, radiance_map()), lambda _: ((3,), ())),
    "fit_water": (
        lambda _: [getattr(medium.fit_water(radiance_map(), 5.0), n) for n in ("kd", "gain")],
        lambda _: ((3,), (3,)),
    ),
    "exposure_change": (lambda _: medium.exposure_change(radiance_map(), radiance_map()), lambda _: ()),
    "picture_change": (lambda _: medium.picture_change(radiance_map(), radiance_map()), lambda _: ()),
    "steady_gain": (lambda _: medium.steady_gain(filled(9, 3), filled(9), filled(9), 25.0), lambda _: (9, 3)),
    "single_scattering": (
        lambda b: medium.single_scattering(VIEW, filled(*b[:1]), 0.1, "petzold", SUN), lambda b: (2, 4, *b[:1]),
    ),
    "shaft_deviation": (lambda _: medium.shaft_deviation(VIEW, MEDIUM, SUN, grid=GRID), lambda _: (2, 4, 3)),
    "shaft_field": (lambda _: medium.shaft_field(SCENE, GRID).table, lambda _: (8, 4, 3)),
    "ShaftField.radiance": (
        lambda _: medium.shaft_field(SCENE, GRID).radiance(towards((5,)), filled(5)), lambda _: (5, 3),
    ),
}  # fmt: skip
REFUSED: Refused = {
    "multiple_scattering": lambda: medium.multiple_scattering(WATER, W, filled(4), filled(3), 0.2),
    "multiple_scattering, light": lambda: medium.multiple_scattering(WATER, W, 3.0, 5.0, 0.2, filled(3)),
    "Water.from_arrays": lambda: Water.from_arrays(W, filled(4), filled(3)),
    "Water.from_arrays, columns": lambda: Water.from_arrays(W, filled(4, 2), filled(4)),
    "LightField": lambda: LightField(filled(4), filled(3)),
    "LightField, rows": lambda: LightField(filled(2, 2), filled(2, 2)),
    "LightField, moments": lambda: LightField(filled(4), filled(4), np.ones((3, 80))),
    "LightField.inscatter": lambda: FIELD.inscatter(filled(4), filled(3), 0.2),
    "LightField.irradiance": lambda: FIELD.irradiance(filled(4), filled(3)),
    "Medium.transmittance": lambda: MEDIUM.transmittance(filled(4), 5.0, filled(3)),
    "Medium.veil": lambda: MEDIUM.veil(filled(4), 5.0, filled(3)),
    "Medium.radiance": lambda: MEDIUM.radiance(filled(4), filled(3)),
    "Medium.irradiance": lambda: MEDIUM.irradiance(filled(4), filled(3)),
    "Medium.scaled": lambda: MEDIUM.scaled(filled(4)),
    "Bands.rgb": lambda: BANDS.rgb(filled(2, 3)),
    "Bands.log_light": lambda: BANDS.log_light(filled(2, 3)),
    "Sensor.from_arrays": lambda: Sensor.from_arrays(W, filled(4, 4)),
    "reflectance": lambda: medium.reflectance(filled(4), W),
    "compress_gamut": lambda: medium.compress_gamut(filled(3, 4)),
    "PlateProfile.from_map": lambda: PlateProfile.from_map(radiance_map(channels=4)),
    "fit_gain": lambda: medium.fit_gain(MEDIUM, radiance_map()[0]),
    "fit_water": lambda: medium.fit_water(radiance_map(channels=2), 5.0),
    "exposure_change": lambda: medium.exposure_change(radiance_map(), radiance_map(16, 32)),
    "exposure_change, grey": lambda: medium.exposure_change(radiance_map()[..., 0], radiance_map()[..., 0]),
    "picture_change": lambda: medium.picture_change(radiance_map(), radiance_map(16, 32)),
    "steady_gain": lambda: medium.steady_gain(filled(9, 3), filled(8), filled(9), 25.0),
    "single_scattering": lambda: medium.single_scattering(VIEW, filled(4), filled(3), "petzold", SUN),
    "single_scattering, end": lambda: medium.single_scattering(VIEW, 0.1, 0.1, "petzold", SUN, end_m=filled(4, 2)),
    "shaft_deviation": lambda: medium.shaft_deviation(VIEW, MEDIUM, SUN, [filled(5, 3)]),
    "shaft_field": lambda: medium.shaft_field(ShaftScene.of(VIEW, MEDIUM, [SUN], [filled(5, 2, 3)])),
    "steady_gain, channels": lambda: medium.steady_gain(filled(9, 4), filled(9), filled(9), 25.0),
}


def test_every_public_function_is_here() -> None:
    assert functions_of(medium) - called(RETURNS) == {"cameras"}  # names
    elementwise_or_made = {"bands", "illuminant", "spectral_model"}
    assert functions_of(medium) - called(REFUSED) - elementwise_or_made == {"cameras"}


def test_what_comes_out(subtests: pytest.Subtests) -> None:
    check_returned(RETURNS, subtests)


def test_other_shapes_are_refused(subtests: pytest.Subtests) -> None:
    check_refused(REFUSED, subtests)
