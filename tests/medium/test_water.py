# SPDX-License-Identifier: Apache-2.0
"""Waters, phase functions, and what loaders refuse."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.medium import JERLOV_TYPES, Medium, Water, WaterSettings
from mr360uw.medium.closed_form import visibility_m, water_of_visibility, water_seen_as_far
from mr360uw.medium.phase import (
    backscatter_ratio,
    henyey_greenstein,
    mean_cosine,
    phase_function,
    phase_moments,
    wide_angle_moments,
)
from tests.medium.tolerances import FLOAT64, PETZOLD_MOMENTS, PHASE_NORM

VISIBLE = np.arange(400.0, 701.0, 5.0)
PHASES = ["isotropic", "petzold", "water", ("hg", 0.9), ("hg", -0.3), ("fournier-forand", 1.10, 3.5835)]


@pytest.mark.parametrize("name", JERLOV_TYPES)
def test_jerlov_types_are_physical(name: str) -> None:
    water = Water.jerlov(name)
    a, b, c, kd = (
        f(VISIBLE) for f in (water.absorption, water.scattering, water.attenuation, water.diffuse_attenuation)
    )
    assert np.all(a > 0.0)
    np.testing.assert_allclose(c, a + b, rtol=FLOAT64)
    assert np.all(kd >= a)
    # diffuse light runs at a slant, twice its depth at most
    assert np.all(kd <= 2.0 * c)


def test_types_grow_murkier() -> None:
    for family in (("I", "IA", "IB", "II", "III"), ("1C", "3C", "5C", "7C", "9C")):
        kd = [Water.jerlov(name).diffuse_attenuation(450.0) for name in family]
        assert np.all(np.diff(kd) > 0.0)


def test_published_figures() -> None:
    water = Water.jerlov("II")
    # as printed at 575 nm, and the paper's repeated row that is put right
    assert (water.absorption(575.0), water.scattering(575.0), water.diffuse_attenuation(575.0)) == (0.0821, 0.332, 0.12)
    assert Water.jerlov("5C").scattering(600.0) < Water.jerlov("5C").scattering(575.0)
    assert Water.jerlov("IB", "williamson2022").scattering(550.0) > 2.0 * Water.jerlov("IB").scattering(550.0)
    assert Water.jerlov("III", kd="jerlov1976").diffuse_attenuation(500.0) != Water.jerlov("III").diffuse_attenuation(
        500.0
    )
    assert "Solonenko" in water.source
    assert "Lee" in Water.jerlov("IB", "williamson2022").source


def test_kd_below_absorption_is_refused() -> None:
    # Jerlov's type I lies below pure water
    with pytest.raises(ParameterError, match="cannot be below absorption"):
        Water.jerlov("I", kd="jerlov1976")
    with pytest.raises(ParameterError, match="cannot be below absorption"):
        Water.from_arrays([400, 700], [0.1, 0.2], [0.1, 0.1], [0.05, 0.3])


@pytest.mark.parametrize(
    ("wavelength", "absorption", "scattering", "message"),
    [
        ([0.4, 0.7], [0.1, 0.2], [0.1, 0.1], "micrometres"),
        ([4e-7, 7e-7], [0.1, 0.2], [0.1, 0.1], "metres"),
        ([4000, 7000], [0.1, 0.2], [0.1, 0.1], "angstroms"),
        ([700, 400], [0.1, 0.2], [0.1, 0.1], "ascends"),
        ([400, 700], [0.1, -0.2], [0.1, 0.1], "absorption must be above zero"),
        ([400, 700], [0.1, 0.2], [0.1, -0.1], "scattering must be at least zero"),
        ([400, 700], [0.1, np.nan], [0.1, 0.1], "finite"),
        ([400, 500, 700], [0.1, 0.2], [0.1, 0.1, 0.1], "one finite value"),
    ],
)
def test_bad_arrays_are_refused(wavelength: list, absorption: list, scattering: list, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        Water.from_arrays(wavelength, absorption, scattering)


def test_wavelengths_beyond_the_table_are_refused() -> None:
    with pytest.raises(ParameterError, match="300 to 700 nm"):
        Water.jerlov("II").absorption([650.0, 720.0])
    with pytest.raises(ParameterError, match="no such Jerlov type"):
        Water.jerlov("IV")
    with pytest.raises(ParameterError, match="outside the models"):
        Water.chlorophyll(100.0)


def test_csv(tmp_path: Path) -> None:
    path = tmp_path / "water.csv"
    path.write_text("# a lake\nwavelength_nm,a,b,kd\n400,0.5,1.0,0.7\n700,0.8,0.9,1.1\n")
    water = Water.from_csv(path)
    assert water.absorption(550.0) == pytest.approx(0.65)
    assert water.diffuse_attenuation(400.0) == pytest.approx(0.7)
    for text, message in (
        ("wavelength_nm,a\n400,1\n700,1\n", "scattering is missing"),
        ("wavelength_nm,a,b\n400,1,x\n700,1,1\n", "not a number"),
        ("wavelength_nm,a,b\n400,1\n", "not a table"),
    ):
        path.write_text(text)
        with pytest.raises(ParameterError, match=message):
            Water.from_csv(path)
    with pytest.raises(ParameterError, match="no such file"):
        Water.from_csv(tmp_path / "none.csv")


def test_pure_water_and_chlorophyll() -> None:
    pure = Water.pure()
    np.testing.assert_allclose(pure.backscattering(VISIBLE), 0.5 * pure.scattering(VISIBLE), rtol=FLOAT64)
    waters = [pure, *(Water.chlorophyll(c) for c in (0.03, 0.3, 3.0))]
    blue = [water.attenuation(440.0) for water in waters]
    assert np.all(np.diff(blue) > 0.0)
    for water in waters:
        assert np.all(water.diffuse_attenuation(VISIBLE) >= water.absorption(VISIBLE))


def test_a_visibility_is_that_of_its_water() -> None:
    for name in ("IA", "IB", "1C", "5C", "9C"):
        of = Water.jerlov(name)
        found = water_of_visibility(visibility_m(of))
        for known, made in ((of.a, found.a), (of.b, found.b), (of.kd, found.kd)):
            assert known is not None
            assert made is not None
            np.testing.assert_allclose(made(VISIBLE[::5]), known(VISIBLE[::5]), rtol=1e-9)  # bisected to 2^-50
    murkier = [water_of_visibility(v) for v in (90.0, 40.0, 20.0, 8.0, 2.0, 1.0, 0.5)]
    for before, after in itertools.pairwise(murkier):
        assert np.all(after.attenuation(VISIBLE) > before.attenuation(VISIBLE))
        assert np.all(after.diffuse_attenuation(VISIBLE) >= after.absorption(VISIBLE))
    # a black target against the solved water: its contrast at the distance of the definition, and that of any type
    for water in (murkier[3], *(water_seen_as_far(Water.jerlov(name), 8.0) for name in ("I", "II", "5C", "9C"))):
        solved = Medium(water, camera_depth_m=5.0)
        at = int(np.argmin(np.abs(solved.bands.wavelength_nm - 532.0)))
        assert solved.spectral_transmittance(8.0)[at] == pytest.approx(0.0082, rel=0.05)  # e^-4.8; 2 nm beside
    for wrong in (0.4, 91.0, np.inf):
        with pytest.raises(ParameterError, match="visibility - is out of range"):
            water_of_visibility(wrong)


def test_a_diver_s_words_for_water() -> None:
    for word, name in (("tropical", "IB"), ("temperate", "1C"), ("harbour", "7C")):
        assert WaterSettings(type=word).water() is Water.jerlov(name)
    sighted = WaterSettings(visibility_m=8.0)
    assert sighted.water() is water_of_visibility(8.0)
    assert sighted.label == "water of 8 m visibility"
    assert WaterSettings(visibility_m=8.0, type="none").water() is None
    both = WaterSettings(visibility_m=8.0, type="5C")
    assert both.water() is water_seen_as_far(Water.jerlov("5C"), 8.0)
    assert both.label == "water 5C of 8 m visibility"


@pytest.mark.parametrize("name", ["I", "IB", "II", "5C"])
def test_a_type_of_a_visibility_keeps_its_colour(name: str) -> None:
    """Murkier water has more particles; clearer water less of all but the water itself."""
    of, pure = Water.jerlov(name), Water.pure()
    own = visibility_m(of)
    murky, clear = (water_seen_as_far(of, sight) for sight in (0.3 * own, min(1.5 * own, 90.0)))
    more = np.maximum(of.absorption(VISIBLE) - pure.absorption(VISIBLE), 0.0)
    np.testing.assert_allclose(murky.absorption(VISIBLE), pure.absorption(VISIBLE) + more, rtol=1e-3)  # a kink
    assert np.all(murky.scattering(VISIBLE) > of.scattering(VISIBLE))
    assert np.all(clear.absorption(VISIBLE) >= pure.absorption(VISIBLE))
    for made, sight in ((murky, 0.3 * own), (clear, min(1.5 * own, 90.0))):
        assert visibility_m(made) == pytest.approx(sight, rel=1e-9)
        assert np.all(made.diffuse_attenuation(VISIBLE) >= made.absorption(VISIBLE))


@pytest.mark.parametrize("phase", PHASES)
def test_phase_functions_are_normalised(phase: str | tuple) -> None:
    edges = np.concatenate([[0.0], np.geomspace(1e-7, np.pi, 400)])
    x, w = np.polynomial.legendre.leggauss(5)
    half = 0.5 * np.diff(edges)[:, None]
    theta = (edges[:-1, None] + half * (x + 1.0)).ravel()
    p = phase_function(phase, theta) * (half * w).ravel() * np.sin(theta) * 2.0 * np.pi
    np.testing.assert_allclose(p.sum(), 1.0, atol=PHASE_NORM)
    np.testing.assert_allclose(np.sum(p * np.cos(theta)), mean_cosine(phase), atol=PHASE_NORM)
    np.testing.assert_allclose(p[theta > 0.5 * np.pi].sum(), backscatter_ratio(phase), atol=PHASE_NORM)
    moments = phase_moments(phase, 33)
    assert moments[0] == 1.0
    assert np.all(np.abs(moments) <= 1.0 + FLOAT64)


def test_petzold() -> None:
    assert mean_cosine("petzold") == pytest.approx(0.924, abs=PETZOLD_MOMENTS)
    assert backscatter_ratio("petzold") == pytest.approx(0.0183, abs=PETZOLD_MOMENTS)
    assert backscatter_ratio(("fournier-forand", 1.10, 3.5835)) == pytest.approx(0.0183, abs=PETZOLD_MOMENTS)


def test_closed_moments_agree_with_quadrature() -> None:
    x, w = np.polynomial.legendre.leggauss(400)
    numerical = 2.0 * np.pi * np.polynomial.legendre.legvander(x, 20).T @ (w * henyey_greenstein(x, 0.8))
    np.testing.assert_allclose(phase_moments(("hg", 0.8), 21), numerical, atol=FLOAT64)


@pytest.mark.parametrize("phase", PHASES)
def test_wide_angles_keep_what_the_peak_leaves(phase: str | tuple) -> None:
    wide = wide_angle_moments(phase, 9)
    np.testing.assert_allclose(wide[0], 1.0 - max(mean_cosine(phase), 0.0) ** 4, atol=PHASE_NORM)
    assert np.all(wide <= phase_moments(phase, 9) + FLOAT64)


def test_unknown_phase_is_refused() -> None:
    for bad in ("rayleigh", ("hg", 1.0), ("fournier-forand", 1.1, 6.0), ("mie", 3.0)):
        with pytest.raises(ParameterError, match="phase - "):
            phase_moments(bad, 3)
