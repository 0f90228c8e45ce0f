# SPDX-License-Identifier: Apache-2.0
"""Jerlov's ten water types: published absorption, scattering and diffuse attenuation over wavelength.

I to III: open ocean, clear to turbid. 1C to 9C: coastal. Sources: Solonenko & Mobley 2015 (a, b and Kd of all ten),
Williamson & Hollins 2022 (a and b of six), Jerlov 1976 and Austin & Petzold 1986 (Kd), Zhang et al. 2009 (molecules).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypedDict, get_args

import numpy as np

from mr360uw.constants import MEAN_COSINE_SEA
from mr360uw.errors import ParameterError
from mr360uw.medium.phase import Phase
from mr360uw.medium.tables import Spectrum, builtin_spectrum, builtin_table

JerlovType = Literal["I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C"]
JERLOV_TYPES: tuple[JerlovType, ...] = get_args(JerlovType)
Inherent = Literal["solonenko2015", "williamson2022"]
Diffuse = Literal["solonenko2015", "jerlov1976", "austin_petzold1986", "lee2005"]

_CITATION = {
    "solonenko2015": "Solonenko & Mobley 2015, Appl. Opt. 54, 5392",
    "williamson2022": "Williamson & Hollins 2022, Appl. Opt. 61, 9951",
    "jerlov1976": "Jerlov 1976, Marine Optics, Table XXVII",
    "austin_petzold1986": "Austin & Petzold 1986, Opt. Eng. 25, 471",
    "lee2005": "Lee et al. 2005, J. Geophys. Res. 110, C02016",
    "zhang2009": "Zhang et al. 2009, Opt. Express 17, 5698",
}


class WaterParts(TypedDict):
    """Fields of the `Water` of one type."""

    name: str
    a: Spectrum
    b: Spectrum
    kd: Spectrum | None
    phase: Phase
    molecular: Spectrum
    source: str


def jerlov_parts(
    water_type: JerlovType, inherent: Inherent = "solonenko2015", kd: Diffuse | None = None, phase: Phase | None = None
) -> WaterParts:
    """Return the coefficients of a type; see `Water.jerlov`. Raises `ParameterError` for unknown names."""
    if inherent not in get_args(Inherent):
        raise ParameterError(f"inherent - unknown source (got {inherent!r}) - take one of {get_args(Inherent)}")
    types = [name for name in builtin_table(f"{inherent}_absorption.csv") if name != "wavelength_nm"]
    if water_type not in types:
        raise ParameterError(f"water - no such Jerlov type (got {water_type!r}) - take one of {', '.join(types)}")
    chosen = kd or ("solonenko2015" if inherent == "solonenko2015" else "lee2005")
    name = f"Jerlov {water_type}"
    b = builtin_spectrum(f"{inherent}_scattering.csv", water_type, f"{name}, scattering")
    return WaterParts(
        name=name,
        a=builtin_spectrum(f"{inherent}_absorption.csv", water_type, f"{name}, absorption"),
        b=b,
        kd=_kd_table(water_type, chosen),
        phase=phase or ("petzold" if inherent == "solonenko2015" else ("hg", MEAN_COSINE_SEA)),
        molecular=molecular_part(b),
        source=f"a, b: {_CITATION[inherent]}; molecules: {_CITATION['zhang2009']}; Kd: {_CITATION[chosen]}",
    )


def molecular_part(b: Spectrum) -> Spectrum:
    """Return the molecular part [1/m] of a total scattering: that of pure sea water (Zhang et al. 2009), at most all.

    The tables of the types give the total alone. Type I scatters no more than pure water: nothing is left of it for
    particles below 550 nm.
    """
    pure = builtin_spectrum("pure_sea_water.csv", "scattering", "pure sea water, scattering")
    return replace(b, name=f"{b.name} by molecules", value=np.minimum(pure(b.wavelength_nm), b.value))


def _kd_table(water_type: JerlovType, source: Diffuse) -> Spectrum | None:
    if source == "lee2005":
        return None
    if source not in get_args(Diffuse):
        raise ParameterError(f"kd - unknown source (got {source!r}) - take one of {get_args(Diffuse)}")
    table = f"{source}_kd.csv"
    if water_type not in builtin_table(table):
        raise ParameterError(f"kd - {source} has no type {water_type} - take another source or type")
    spectrum = builtin_spectrum(table, water_type, f"Jerlov {water_type}, Kd")
    if source == "solonenko2015":
        return spectrum
    # the sources disagree in the ultraviolet, which no camera sees
    visible = spectrum.wavelength_nm >= 400.0
    return replace(spectrum, wavelength_nm=spectrum.wavelength_nm[visible], value=spectrum.value[visible])
