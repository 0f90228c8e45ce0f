# SPDX-License-Identifier: Apache-2.0
"""How light fades: along the camera's ray, with depth, along the sun's beam; and what of a pattern it still bears.

What the tables give is compared with sums over wavelengths written out here.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from mr360uw.gl import texture_from_array
from mr360uw.medium import Medium, Sensor, Water
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, transmittance_lookup, unscattered_share
from mr360uw.types import MediumTable
from tests.glsl import glsl_call
from tests.medium.tolerances import ANALYTIC_FIELD, FLOAT32_LOOKUP, FLOAT64, GREY_OF_OBSERVER, TABLE_BEAM

SENSORS = {"camera": "Insta360 X5", "observer": "CIE 1931"}
CLEAR = ("I", "IA", "IB", "II", "III")


@functools.cache
def water_of(sensor: str, name: str, camera_m: float, mode: str = "table") -> Medium:
    seen_by = Sensor.cie1931() if sensor == "observer" else Sensor.camera(SENSORS[sensor])
    return Medium(Water.jerlov(name), seen_by, mode, camera_m, band_count=31)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("camera_m", [1.0, 20.0])
@pytest.mark.parametrize("name", [*CLEAR, "9C"])
def test_objects_fade_as_light_does(sensor: str, camera_m: float, name: str) -> None:
    medium = water_of(sensor, name, camera_m)
    s = np.linspace(0.0, 40.0, 401)
    through = medium.transmittance(s, camera_m, 0.0)
    looked_up = transmittance_lookup(medium.table, s, 0.0)
    for t in (through, looked_up):
        left = t.min(axis=1) > 1e-3
        assert np.all(np.diff(t[left], axis=0) < 0.0)
        if name in CLEAR:  # water takes red first
            beyond = left & (s >= 1.0)
            assert np.all(t[beyond, 0] <= t[beyond, 1])
    # a channel fades no faster than its worst wavelength and no slower than its best, and ever more slowly
    seen = medium.bands.lobes > 0.0
    rate = -np.log(through[1:]) / s[1:, None]
    for channel in range(3):
        extinction = medium.model.extinction[seen[:, channel]]
        assert np.all(rate[:, channel] >= extinction.min() * (1.0 - FLOAT64))
        assert np.all(rate[:, channel] <= extinction.max() * (1.0 + FLOAT64))
        # what one length leaves is what passes the next one best
        first, second = through[10::10, channel], through[:-10:10, channel]
        both = through[10::10, channel][1:]
        assert np.all(both >= first[0] * second[1:] * (1.0 - FLOAT64))
        assert np.all(both <= second[1:] * np.exp(-extinction.min() * 1.0) * (1.0 + FLOAT64))


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("name", [*CLEAR, "9C"])
def test_daylight_fades_with_depth(sensor: str, name: str) -> None:
    medium = water_of(sensor, name, 1.0)
    depth = np.linspace(0.0, 40.0, 401)
    ratio = ambient_ratio(medium.table, depth)
    left = ratio.min(axis=1) > 1e-3
    assert np.all(np.diff(ratio[left], axis=0) < 0.0)
    np.testing.assert_allclose(ambient_ratio(medium.table, 1.0), 1.0, rtol=FLOAT64)
    if name in CLEAR:
        deeper = left & (depth >= 2.0)
        assert np.all(ratio[deeper, 0] <= ratio[deeper, 1])


def test_under_the_observer_grey_stays_near_its_colour() -> None:
    """Where the colours are within the gamut, fading by lobes is off from the signed sums by a bounded part."""
    for name in CLEAR:
        for camera_m in (1.0, 3.0):
            medium = water_of("observer", name, camera_m)
            light = medium.model.irradiance(np.array(camera_m), 1.0)
            s = np.linspace(0.2, 5.0, 25)
            left = medium.bands.rgb(light * medium.spectral_transmittance(s))
            inside = left.min(axis=1) > 0.1 * left.max(axis=1)
            assert inside.sum() >= 4
            got = medium.bands.rgb(light) * medium.transmittance(s, camera_m, 0.0)
            error = np.linalg.norm(got - left, axis=1) / np.linalg.norm(left, axis=1)
            assert error[inside].max() < GREY_OF_OBSERVER
    medium = water_of("camera", "IB", 3.0)
    light = medium.model.irradiance(np.array(3.0), 1.0)
    left = medium.bands.rgb(light * medium.spectral_transmittance(s))
    np.testing.assert_allclose(medium.bands.rgb(light) * medium.transmittance(s, 3.0, 0.0), left, rtol=ANALYTIC_FIELD)


SUNS = (0.3, 0.7, 0.95, 1.0)
DEPTHS = np.array([0.0, 0.5, 1.5, 3.0, 6.0, 8.0, 10.0, 13.0, 20.0])


def beam(medium: Medium, per_metre: np.ndarray, path_m: np.ndarray) -> np.ndarray:
    """The colour of a beam after a path from the surface, summed over the wavelengths."""
    return np.exp(-per_metre * np.asarray(path_m)[..., None]) @ medium.bands.lobes


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("mode", ["table", "kd"])
@pytest.mark.parametrize("name", ["IB", "II", "9C"])
@pytest.mark.parametrize("camera_m", [3.0, 10.0])
def test_the_beam_is_that_of_its_slant_path(sensor: str, mode: str, name: str, camera_m: float) -> None:
    medium = water_of(sensor, name, camera_m, mode)
    for up in SUNS:
        expected = beam(medium, medium.model.extinction, DEPTHS / up)
        camera = beam(medium, medium.model.extinction, np.array(camera_m / up))
        seen = np.minimum(expected, camera) > 1e-3
        ratio = beam_ratio(medium.table, DEPTHS, up)
        np.testing.assert_allclose(ratio[seen], (expected / camera)[seen], rtol=TABLE_BEAM)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("name", ["IB", "II", "3C"])
def test_the_pattern_is_borne_by_what_is_unscattered(sensor: str, name: str) -> None:
    medium, water = water_of(sensor, name, 3.0), Water.jerlov(name)
    w = medium.bands.wavelength_nm
    for up in SUNS:
        unscattered = beam(medium, water.attenuation(w), DEPTHS / up)
        whole = beam(medium, medium.model.extinction, DEPTHS / up)
        seen = unscattered > 1e-4
        share = unscattered_share(medium.table, DEPTHS, up)
        np.testing.assert_allclose(share[seen], (unscattered / whole)[seen], rtol=TABLE_BEAM)
        assert np.all(np.diff(share, axis=0) <= FLOAT64)
        np.testing.assert_array_equal(share[0], 1.0)


@pytest.mark.parametrize("name", ["IB", "II", "3C"])
@pytest.mark.parametrize("up", [0.5, 0.85, 1.0])
def test_contrast_in_all_light(name: str, up: float) -> None:
    """Unscattered over all downwelling light is exp(-(c/up - Kd) d) where all of it came as a beam."""
    medium, water = water_of("camera", name, 3.0), Water.jerlov(name)
    nm = medium.bands.wavelength_nm
    k = int(np.argmin(np.abs(nm - 550.0)))
    c, kd = water.attenuation(nm)[k], water.diffuse_attenuation(nm)[k]
    one = medium_of_one_wavelength(medium, k)
    depth = np.array([1.0, 3.0, 6.0])
    beam_at = (beam_ratio(one, depth, up) / beam_ratio(one, 0.0, up))[:, 0]
    pattern = beam_at * unscattered_share(one, depth, up)[:, 0]
    np.testing.assert_allclose(pattern / np.exp(-kd * depth), np.exp(-(c / up - kd) * depth), rtol=TABLE_BEAM)


def medium_of_one_wavelength(medium: Medium, k: int) -> MediumTable:
    """The tables of a sensor that sees one wavelength of a medium."""
    nm = medium.bands.wavelength_nm[k]
    response = np.broadcast_to([[0.0], [0.0], [1.0], [0.0], [0.0]], (5, 3))
    sensor = Sensor.from_arrays([380.0, nm - 1.0, nm, nm + 1.0, 720.0], response)
    return Medium(medium.water, sensor, "table", medium.camera_depth_m, band_count=31).table


@pytest.mark.usefixtures("gl")
def test_twins_of_a_real_water() -> None:
    table = water_of("camera", "II", 3.0).table
    depth = np.linspace(0.0, 25.0, 300).astype(np.float32)
    textures = {"beam": texture_from_array(np.stack([table.beam, table.unscattered]))}
    uniforms = {"medium__camera_depth_m": table.camera_depth_m, "medium__length_m": table.length_m}
    declared = "uniform MediumTable medium; uniform sampler2D beam;"
    for up in (0.3, 0.95):
        for call, expected in (("beam_ratio", beam_ratio), ("unscattered_share", unscattered_share)):
            expression = f"{call}(medium, beam, d, {up})"
            got = glsl_call("medium/lookup.glsl", expression, 3, declared, textures, uniforms, d=depth)
            np.testing.assert_allclose(
                got, expected(table, depth, up), rtol=FLOAT32_LOOKUP, atol=FLOAT32_LOOKUP, err_msg=call
            )
