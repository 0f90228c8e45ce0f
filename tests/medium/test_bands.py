# SPDX-License-Identifier: Apache-2.0
"""Sensors, bands, the gamut, spectra of albedos."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mr360uw.base.color import luminance
from mr360uw.base.disk_cache import FOLDER
from mr360uw.errors import ParameterError
from mr360uw.medium import Sensor, Water, bands, cameras, compress_gamut, multiple_scattering, reflectance
from mr360uw.medium.spectra import illuminant, named_sensor
from mr360uw.medium.wavelengths import search
from tests.medium.tolerances import FITTED_MEAN_6, FITTED_P95_12, FLOAT64, UPSAMPLED_COLOUR, UPSAMPLING, WHITE

SENSORS = [Sensor.cie1931(), Sensor.camera("Insta360 X5")]


def veils(wavelength_nm: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Veils (r, n) of random rays in waters that the fit knows and in some it does not."""
    waters = [Water.jerlov(name) for name in ("I", "IB", "II", "III", "1C", "5C", "9C")]
    waters += [Water.chlorophyll(c) for c in (0.05, 0.5, 2.0)]
    depth, distance, up = rng.uniform(1, 20, 40), 0.2 + rng.exponential(10, 40), rng.uniform(-1, 1, 40)
    return np.concatenate([multiple_scattering(w, wavelength_nm, distance, depth, up) for w in waters])


def errors(rule: str, n: int, sensor: Sensor) -> np.ndarray:
    exact, few = bands(600, sensor), bands(n, sensor, rule)
    expected = exact.rgb(veils(exact.wavelength_nm, np.random.default_rng(1)))
    got = few.rgb(veils(few.wavelength_nm, np.random.default_rng(1)))
    return np.linalg.norm(got - expected, axis=1) / np.linalg.norm(expected, axis=1)


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: s.name)
@pytest.mark.parametrize("rule", ["rectangle", "integrated", "fitted"])
@pytest.mark.parametrize("n", [4, 8, 12])
@pytest.mark.parametrize("light", ["equal-energy", "D65"])
def test_white_is_white(sensor: Sensor, rule: str, n: int, light: str) -> None:
    few = bands(n, sensor, rule, light)
    assert few.wavelength_nm.shape == (n,)
    assert few.weight.shape == (n, 3)
    np.testing.assert_allclose(few.rgb(np.ones(n)), 1.0, rtol=WHITE)
    assert np.all(np.diff(few.wavelength_nm) > 0.0)


@pytest.mark.parametrize("n", [1, 2, 3, 61, 1000])
def test_any_number_of_bands(n: int) -> None:
    np.testing.assert_allclose(bands(n, SENSORS[1]).rgb(np.ones(n)), 1.0, rtol=WHITE)


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: s.name)
def test_fitted_bands_are_accurate(sensor: Sensor) -> None:
    assert errors("fitted", 6, sensor).mean() < FITTED_MEAN_6
    assert np.quantile(errors("fitted", 12, sensor), 0.95) < FITTED_P95_12
    assert errors("fitted", 8, sensor).mean() < 0.5 * errors("rectangle", 8, sensor).mean()


def test_fitted_weights_of_a_camera_are_not_negative() -> None:
    few = bands(8, SENSORS[1], "fitted")
    assert np.all(few.weight >= 0.0)
    assert not few.signed
    assert bands(8, SENSORS[0], "fitted").signed


def test_the_stored_search_is_the_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mr360uw.medium import wavelengths as choice

    monkeypatch.setenv(FOLDER, str(tmp_path))
    stored = bands(4, SENSORS[1], "fitted")
    monkeypatch.setattr(choice, "_stored", dict)
    searched = bands(4, SENSORS[1], "fitted")
    np.testing.assert_allclose(searched.weight, stored.weight, atol=WHITE)
    assert len(list(tmp_path.iterdir())) == 1
    monkeypatch.setattr(choice, "search", lambda *_: pytest.fail("the cache was not read"))
    np.testing.assert_array_equal(bands(4, SENSORS[1], "fitted").weight, searched.weight)


def test_the_search_honours_the_range() -> None:
    wavelength, weight = search(3, SENSORS[1], "equal-energy", (450.0, 650.0))
    assert wavelength[0] >= 450.0
    assert wavelength[-1] <= 650.0
    assert np.all(weight >= 0.0)


def test_cameras() -> None:
    assert len(cameras()) == 52
    for name in cameras():
        assert Sensor.camera(name).name == name
    assert "Insta360 X5" in Sensor.camera("insta360 x5").name
    for bad in ("Nikon", "Kodak Brownie", ""):
        with pytest.raises(ParameterError, match="camera - "):
            Sensor.camera(bad)
    assert named_sensor("CIE 1931").name == Sensor.cie1931().name


def test_sensor_csv(tmp_path: Path) -> None:
    path = tmp_path / "sensor.csv"
    path.write_text("wavelength_nm,R,G,B\n400,0,0.1,0.9\n550,0.2,1,0.1\n700,0.9,0.1,0\n")
    assert bands(5, named_sensor(str(path))).weight.shape == (5, 3)
    for text, message in (
        ("wavelength_nm,R,G\n400,1,1\n700,1,1\n", "column b is missing"),
        ("wavelength_nm,R,G,B\n400,1,1,0\n700,1,1,0\n", "not all zero"),
        ("wavelength_nm,R,G,B\n0.4,1,1,1\n0.7,1,1,1\n", "micrometres"),
    ):
        path.write_text(text)
        with pytest.raises(ParameterError, match=message):
            Sensor.from_csv(path)


def test_illuminants() -> None:
    assert illuminant("D65")(560.0) == pytest.approx(1.0)
    assert illuminant("equal-energy")(560.0) == 1.0
    assert illuminant("sun-sky")(560.0) == pytest.approx(1.0)
    assert illuminant("A")(700.0) > illuminant("A")(400.0)
    with pytest.raises(ParameterError, match="illuminant - unknown"):
        illuminant("moon")


def test_bad_bands_are_refused() -> None:
    for n, rule in ((0, "rectangle"), (1001, "rectangle"), (8, "gauss"), (1, "fitted"), (25, "fitted")):
        with pytest.raises(ParameterError, match=" - "):
            bands(n, SENSORS[0], rule)
    with pytest.raises(ParameterError, match="beyond the sensor"):
        bands(8, SENSORS[0], range_nm=(300.0, 700.0))


def test_gamut(rng: np.random.Generator) -> None:
    inside = rng.uniform(0.2, 1.0, (500, 3))
    np.testing.assert_allclose(compress_gamut(inside), inside, rtol=FLOAT64)
    wild = np.concatenate([rng.uniform(-0.5, 1.0, (500, 3)), [[-0.28, 0.4, 1.0], [0.0, 0.0, 0.0], [-1.0, -1.0, -1.0]]])
    mapped = compress_gamut(wild)
    assert np.all(mapped >= 0.0)
    lit = luminance(wild) > 0.0
    np.testing.assert_allclose(luminance(mapped)[lit], luminance(wild)[lit], rtol=FLOAT64)
    np.testing.assert_allclose(compress_gamut(7.0 * wild), 7.0 * mapped, rtol=FLOAT64)
    # monotone: more red before is more red after
    ramp = np.column_stack([np.linspace(-0.5, 1.0, 200), np.full(200, 0.5), np.ones(200)])
    assert np.all(np.diff(compress_gamut(ramp)[:, 0] / compress_gamut(ramp)[:, 2]) > 0.0)


def test_reflectances_reproduce_their_colour(rng: np.random.Generator) -> None:
    albedo = rng.uniform(0.0, 1.0, (50, 3))
    w = np.arange(400.0, 701.0, 5.0)
    spectra = reflectance(albedo, w)
    assert np.all((spectra >= -FLOAT64) & (spectra <= 1.0 + UPSAMPLING))
    np.testing.assert_allclose(reflectance([0.5, 0.5, 0.5], w), 0.5, atol=UPSAMPLING)
    seen = bands(61, Sensor.cie1931(), "integrated", "D65").rgb(reflectance(albedo, bands(61).wavelength_nm))
    np.testing.assert_allclose(seen, albedo, atol=UPSAMPLED_COLOUR)


def test_public_names_are_not_modules() -> None:
    """A submodule of the same name would take the place of a function once something imports it."""
    import mr360uw.medium as medium

    for name in medium.__all__:
        assert not isinstance(getattr(medium, name), ModuleType), name
