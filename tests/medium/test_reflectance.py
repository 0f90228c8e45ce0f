# SPDX-License-Identifier: Apache-2.0
"""Reflectance of clear water just below the surface against published formulas and measurements at sea.

R = E_u/E_d, r = L_u/E_d [1/sr] of light that rises straight up, both just below the surface; a, bb: absorption and
backscattering [1/m].
"""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.medium import LightField, Medium, Water
from mr360uw.medium.spectra import builtin_table
from tests.medium.tolerances import CLEAR_OCEAN, REFLECTANCE_CASE1, REFLECTANCE_RADIANCE

NM = np.arange(400.0, 701.0, 20.0)
CLEAR = [Water.jerlov("I"), Water.jerlov("IA"), Water.jerlov("IB"), Water.chlorophyll(0.03), Water.chlorophyll(0.1)]


def field(water: Water, nm: np.ndarray = NM) -> LightField:
    return LightField(water.absorption(nm), water.scattering(nm), water.moments(nm, 65))


@pytest.mark.parametrize("water", CLEAR, ids=lambda water: water.name)
def test_radiance_from_below_is_that_of_lee_2004(water: Water) -> None:
    # Lee et al. 2004, Appl. Opt. 43, 4957: molecules and particles reflect by coefficients of their own
    assert water.molecular is not None
    molecules = 0.5 * water.molecular(NM)
    particles = water.backscattering(NM) - molecules
    total = water.absorption(NM) + molecules + particles
    of_particles = 0.197 * (1.0 - 0.636 * np.exp(-2.552 * particles / total))
    expected = 0.113 * molecules / total + of_particles * particles / total
    np.testing.assert_allclose(field(water).radiance(0.0, -1.0), expected, rtol=REFLECTANCE_RADIANCE)


@pytest.mark.parametrize("mg_m3", [0.03, 0.1])
def test_reflectance_is_that_of_case_1_waters(mg_m3: float) -> None:
    # Morel & Maritorena 2001: their bb, and R = 0.33 bb/a with a from Kd by iteration
    water = Water.chlorophyll(mg_m3)
    nm = NM[NM >= 480.0]  # below, their pure water is that of Pope & Fry, up to thrice as dark as Mason et al. have it
    table = builtin_table("morel_maritorena2001_kd.csv")
    kd = np.interp(nm, table["wavelength_nm"], table["kw"] + table["chi"] * mg_m3 ** table["e"])
    slope = 0.5 * (np.log10(mg_m3) - 0.3)
    share = 0.002 + 0.01 * (0.5 - 0.25 * np.log10(mg_m3)) * (nm / 550.0) ** slope
    back = 0.5 * Water.pure().scattering(nm) + share * 0.416 * mg_m3**0.766
    reflectance = 0.33 * back / (0.75 * kd)
    for _ in range(5):
        reflectance = 0.33 * back / (0.9 * (1.0 - reflectance) / (1.0 + 2.25 * reflectance) * kd)
    solved = field(water, nm)
    np.testing.assert_allclose(
        solved.irradiance(0.0, -1.0) / solved.irradiance(0.0, 1.0), reflectance, rtol=REFLECTANCE_CASE1
    )


def test_clear_ocean_is_as_bright_as_measured() -> None:
    # Gordon & Clark 1981, Appl. Opt. 20, 4175: water-leaving radiance 0.498 and 0.30 mW/(cm2 um sr) at 520 and 550 nm
    # where chlorophyll is below 0.25 mg/m3, over the sun's 185 and 187 mW/(cm2 um) outside the atmosphere
    nm = np.array([520.0, 550.0])
    measured = np.array([0.498 / 185.0, 0.30 / 187.0])
    below = field(Water.jerlov("IB"), nm).radiance(0.0, -1.0)
    leaving = 0.52 * below / (1.0 - 1.7 * below)  # Lee et al. 2002, Appl. Opt. 41, 5755
    np.testing.assert_allclose(leaving, measured, rtol=CLEAR_OCEAN)


def test_clear_water_is_no_black_hole() -> None:
    # without its molecules the water of type IA would be twenty times darker straight down
    water = Water.jerlov("IA")
    down = Medium(water, camera_depth_m=5.0).model.radiance(5.0, -1.0)
    particles = Water(water.name, water.a, water.b, water.kd, water.phase)
    assert np.all(down > 5.0 * Medium(particles, camera_depth_m=5.0).model.radiance(5.0, -1.0))


def test_molecules_are_part_of_the_scattering() -> None:
    for name in ("I", "IA", "IB", "II", "9C"):
        for source in ("solonenko2015", "williamson2022"):
            if source == "williamson2022" and name in ("I", "IA", "9C"):
                continue
            water = Water.jerlov(name, source)
            assert water.molecular is not None
            assert np.all(water.molecular(NM) <= water.scattering(NM))
            assert np.all(water.backscattering(NM) > 0.4 * water.molecular(NM))
