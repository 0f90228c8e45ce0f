# SPDX-License-Identifier: Apache-2.0
"""Waters: absorption, scattering and diffuse attenuation over wavelength, and phase function.

    a  absorption [1/m]     b  scattering [1/m]     c = a + b  beam attenuation     Kd  diffuse attenuation of E_d

Sources: Solonenko & Mobley 2015 and Williamson & Hollins 2022 (Jerlov types, a and b); Jerlov 1976, Austin & Petzold
1986 (Kd); Mason et al. 2016, Pope & Fry 1997, Zhang et al. 2009 (pure sea water); Morel & Maritorena 2001, Bricaud et
al. 1998 (chlorophyll); Lee et al. 2005 (Kd from a and b). The tables' own headers cite them in full. Jerlov's types I
to III are open ocean, clear to turbid, 1C to 9C coastal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import PositiveInt

from mr360uw.base.cache import shared
from mr360uw.base.constants import MEAN_COSINE_SEA
from mr360uw.base.parameters import checked, exactly, numbers
from mr360uw.errors import ParameterError
from mr360uw.medium.phase import Mixture, Phase, backscatter_ratio, check_phase, particles_of_backscatter
from mr360uw.medium.spectra import Spectrum, builtin_spectrum, builtin_table, read_columns
from mr360uw.plot import Figure, Shown
from mr360uw.types import Array

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
    table = f"{source}_kd.csv"
    if water_type not in builtin_table(table):
        raise ParameterError(f"kd - {source} has no type {water_type} - take another source or type")
    spectrum = builtin_spectrum(table, water_type, f"Jerlov {water_type}, Kd")
    if source == "solonenko2015":
        return spectrum
    # the sources disagree in the ultraviolet, which no camera sees
    visible = spectrum.wavelength_nm >= 400.0
    return replace(spectrum, wavelength_nm=spectrum.wavelength_nm[visible], value=spectrum.value[visible])


_SHOWN_NM = 550.0
"""Wavelength [nm] of the coefficients that a water's line shows: green, where the eye sees best."""
_DENSEST = 1e4
"""Largest coefficient [1/m]: light ends within a tenth of a millimetre, where mud has some tens."""
_KD_ROUNDING = 1.03
"""Kd may be below a by this factor, the rounding of tables with two or three figures; below that it is an error."""


@checked
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Water(Shown):
    """Water with the same optical properties everywhere.

    It has coefficients, no light: `LightField` finds the light in it, `Medium` what a camera sees of it.

    Parameters
    ----------
    name : str
        Used in messages.
    a : Spectrum
        Absorption [1/m], above 0.
    b : Spectrum
        Scattering [1/m], at least 0.
    kd : Spectrum, optional
        Diffuse attenuation [1/m], not below a; None derives it from a and b.
    phase : Phase
        Phase function of the particles; `phase.Phase` lists them.
    molecular : Spectrum, optional
        The part [1/m] of b due to the water itself; None if `phase` holds for all of b.
    source : str
        Citation of the figures.

    Raises
    ------
    ParameterError
        If a <= 0, b < 0 or Kd < a at any wavelength.

    See Also
    --------
    uw.medium.Water.jerlov : One of ten common types.
    uw.medium.LightField : The light in such water, solved.
    uw.medium.Medium : The water as a camera sees it.

    Notes
    -----
    Kd without a table is that of Lee et al. 2005, equation 11.

    Examples
    --------
    >>> water = uw.medium.Water.jerlov("IB")
    >>> water
    <Water Jerlov IB: a 0.0623, b 0.0536, Kd 0.0726 1/m at 550 nm>
    >>> water.attenuation(550.0).round(3)
    np.float64(0.116)
    """

    name: str
    a: Spectrum
    b: Spectrum
    kd: Spectrum | None = None
    phase: Phase = ("hg", MEAN_COSINE_SEA)
    molecular: Spectrum | None = None
    source: str = "given by the user"

    def __post_init__(self) -> None:
        check_phase(self.phase)
        for label, spectrum, strict in (("absorption", self.a, True), ("scattering", self.b, False)):
            wrong = (spectrum.value <= 0.0 if strict else spectrum.value < 0.0) | (spectrum.value > _DENSEST)
            if np.any(wrong):
                i = int(np.argmax(wrong))
                least = "above zero" if strict else "at least zero"
                raise ParameterError(
                    f"{self.name} - {label} must be {least} and at most {_DENSEST:g} "
                    f"(got {spectrum.value[i]:g} 1/m at {spectrum.wavelength_nm[i]:g} nm) - correct the table"
                )
        low = max(self.a.wavelength_nm[0], self.b.wavelength_nm[0])
        high = min(self.a.wavelength_nm[-1], self.b.wavelength_nm[-1])
        if low > high:
            raise ParameterError(
                f"{self.name} - absorption and scattering share no wavelength - use tables that overlap"
            )
        if self.kd is not None:
            self._check_diffuse(self.kd)

    def _check_diffuse(self, kd: Spectrum) -> None:
        w = kd.wavelength_nm
        w = w[(w >= self.a.wavelength_nm[0]) & (w <= self.a.wavelength_nm[-1])]
        if len(w) == 0:
            raise ParameterError(f"{self.name} - absorption and Kd share no wavelength - use tables that overlap")
        ratio = kd(w) / self.a(w)
        if np.min(ratio) * _KD_ROUNDING < 1.0:
            i = int(np.argmin(ratio))
            raise ParameterError(
                f"{self.name} - diffuse attenuation cannot be below absorption (got Kd {kd(w[i]):.4g} < a "
                f"{self.a(w[i]):.4g} 1/m at {w[i]:g} nm) - take both from one source, or kd='lee2005'"
            )

    @property
    def range_nm(self) -> tuple[float, float]:
        """First and last wavelength [nm] at which all coefficients are known."""
        known = [s for s in (self.a, self.b, self.kd, self.molecular) if s is not None]
        return max(float(s.wavelength_nm[0]) for s in known), min(float(s.wavelength_nm[-1]) for s in known)

    def __repr__(self) -> str:
        low, high = self.range_nm
        at = min(max(_SHOWN_NM, low), high)
        a, b, kd = (float(f(at)) for f in (self.absorption, self.scattering, self.diffuse_attenuation))
        return f"<Water {self.name}: a {a:.3g}, b {b:.3g}, Kd {kd:.3g} 1/m at {at:g} nm>"

    def _figure(self) -> Figure:
        w = np.linspace(*self.range_nm, 101)
        curves = {"a": self.absorption(w), "b": self.scattering(w), "Kd": self.diffuse_attenuation(w)}
        return Figure(self.name, w, curves, "wavelength [nm]", "1/m")

    def absorption(self, wavelength_nm: ArrayLike) -> Array:
        """Return the absorption a.

        Light that is absorbed is gone; exp(-a s) of it is left after a path s without scattering.

        Parameters
        ----------
        wavelength_nm : array_like
            Wavelengths (...,) [nm].

        Returns
        -------
        ndarray
            Absorption (...,) [1/m].

        Raises
        ------
        ParameterError
            If a wavelength is beyond the table.

        See Also
        --------
        uw.medium.Water.scattering : Light that turns instead.
        uw.medium.Water.attenuation : The sum of both.

        Examples
        --------
        >>> uw.medium.Water.pure().absorption([450.0, 650.0]).round(4).tolist()
        [0.0081, 0.3421]
        """
        return self.a(wavelength_nm)

    def scattering(self, wavelength_nm: ArrayLike) -> Array:
        """Return the scattering b.

        It counts turns by any angle. In the sea half of them are by less than 5 degrees, and blur a picture more than
        they dim it.

        Parameters
        ----------
        wavelength_nm : array_like
            Wavelengths (...,) [nm].

        Returns
        -------
        ndarray
            Scattering (...,) [1/m].

        Raises
        ------
        ParameterError
            If a wavelength is beyond the table.

        See Also
        --------
        uw.medium.Water.backscattering : The part that turns back.
        uw.medium.Water.absorption : Light that is lost instead.
        uw.medium.Water.attenuation : The sum of both.

        Examples
        --------
        >>> uw.medium.Water.pure().scattering([450.0, 650.0]).round(5).tolist()
        [0.00398, 0.00085]
        """
        return self.b(wavelength_nm)

    def attenuation(self, wavelength_nm: ArrayLike) -> Array:
        """Return the beam attenuation c = a + b.

        Of a narrow beam exp(-c s) is left after a path s, as a transmissometer measures it. A picture keeps more
        contrast, as light that turns by small angles still reaches the camera.

        Parameters
        ----------
        wavelength_nm : array_like
            Wavelengths (...,) [nm].

        Returns
        -------
        ndarray
            Beam attenuation (...,) [1/m].

        Raises
        ------
        ParameterError
            If a wavelength is beyond the tables.

        See Also
        --------
        uw.medium.Medium.transmittance : The loss in a picture.
        uw.medium.Water.diffuse_attenuation : The loss of daylight with depth.

        Examples
        --------
        >>> uw.medium.Water.jerlov("II").attenuation([450.0, 650.0]).round(3).tolist()
        [0.528, 0.604]
        """
        return self.a(wavelength_nm) + self.b(wavelength_nm)

    def backscattering(self, wavelength_nm: ArrayLike) -> Array:
        """Return the backscattering bb, from the phase function.

        The part of b that turns by more than 90 degrees: with absorption it decides how bright water looks from above.

        Parameters
        ----------
        wavelength_nm : array_like
            Wavelengths (...,) [nm].

        Returns
        -------
        ndarray
            Backscattering (...,) [1/m]; molecules scatter half of their light backwards.

        Raises
        ------
        ParameterError
            If a wavelength is beyond the tables.

        See Also
        --------
        uw.medium.Water.scattering : Scattering by all angles.
        uw.medium.PhaseTable : A phase function of one's own.

        Examples
        --------
        >>> water = uw.medium.Water.pure()
        >>> float(water.backscattering(500.0) / water.scattering(500.0))
        0.5
        """
        molecular = self.molecular(wavelength_nm) if self.molecular else np.zeros(np.shape(wavelength_nm))
        return 0.5 * molecular + backscatter_ratio(self.phase) * (self.b(wavelength_nm) - molecular)

    def diffuse_attenuation(self, wavelength_nm: ArrayLike) -> Array:
        """Return the diffuse attenuation Kd of downwelling irradiance.

        Daylight falls about as exp(-Kd z) with depth z, in most waters far more slowly than a beam. It depends on sun
        and sky too: for a given sky take that of a solved field.

        Parameters
        ----------
        wavelength_nm : array_like
            Wavelengths (...,) [nm].

        Returns
        -------
        ndarray
            Kd (...,) [1/m], as tabulated, or derived from a and bb under a sun at the zenith.

        Raises
        ------
        ParameterError
            If a wavelength is beyond the tables.

        See Also
        --------
        uw.medium.LayeredField.diffuse_attenuation : Kd of a solved field.
        uw.medium.Water.attenuation : The loss of a beam.

        Notes
        -----
        Derived by Lee et al. 2005, equation 11: Kd = a + 4.18 (1 - 0.52 exp(-10.8 a)) bb.

        Examples
        --------
        >>> uw.medium.Water.jerlov("IB").diffuse_attenuation([450.0, 550.0, 650.0]).round(3).tolist()
        [0.034, 0.073, 0.349]
        """
        if self.kd is not None:
            return self.kd(wavelength_nm)
        a = self.a(wavelength_nm)
        return a + 4.18 * (1.0 - 0.52 * np.exp(-10.8 * a)) * self.backscattering(wavelength_nm)

    @checked
    def moments(self, wavelength_nm: ArrayLike, count: PositiveInt) -> Array:
        """Return Legendre moments (n, count) of the phase function of molecules and particles together."""
        return self.phases(wavelength_nm).moments(count)

    @checked
    def phases(self, wavelength_nm: ArrayLike, *, wide_angle: bool = False) -> Mixture:
        """Return the phase functions of molecules and particles together at wavelengths (n,).

        wide_angle: without the forward peak, see `phase.wide_angle_moments`.
        """
        w = np.atleast_1d(np.asarray(wavelength_nm, np.float64))
        share = np.zeros(len(w))
        if self.molecular is not None:
            b = self.b(w)
            share = np.divide(self.molecular(w), b, out=share, where=b > 0.0)
        return Mixture(self.phase, share, wide_angle)

    @checked
    def with_phase(self, phase: Phase) -> Water:
        """Return the same water with another phase function of its particles; molecules scatter as before."""
        return replace(self, phase=phase)

    @classmethod
    @checked
    def jerlov(
        cls,
        water_type: str,
        inherent: Inherent = "solonenko2015",
        kd: Diffuse | None = None,
        phase: Phase | None = None,
    ) -> Water:
        """Return a Jerlov type; the molecules' part of b is that of pure sea water.

        For water that was not measured. In the words of a scene, IB is tropical water, 1C temperate and 7C a harbour.

        Parameters
        ----------
        water_type : {"I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C"}
            Open ocean, clear to turbid, then coastal.
        inherent : {"solonenko2015", "williamson2022"}
            Source of a and b: Solonenko & Mobley 2015 (all ten) or Williamson & Hollins 2022 (six).
        kd : {"solonenko2015", "jerlov1976", "austin_petzold1986", "lee2005"}, optional
            Source of Kd; without it that of Solonenko & Mobley, or Lee et al. 2005 for Williamson & Hollins.
        phase : Phase, optional
            Phase function of the particles; without it Petzold's average for Solonenko & Mobley, whose Kd goes with it,
            else Henyey-Greenstein g = 0.9.

        Returns
        -------
        Water
            The same object for the same arguments.

        Raises
        ------
        ParameterError
            If a type or a source is not known.

        See Also
        --------
        uw.medium.Water.chlorophyll : Open ocean of a chlorophyll concentration.
        uw.medium.Water.from_csv : Measured coefficients.
        uw.medium.fit_water : Finds the nearest type of a plate.

        Examples
        --------
        >>> uw.medium.Water.jerlov("1C").diffuse_attenuation(550.0).round(3)
        np.float64(0.129)
        """
        return _jerlov(cast("JerlovType", water_type), inherent, kd, phase)

    @classmethod
    def pure(cls) -> Water:
        """Return pure sea water of 20 degC and 35 psu, 300 to 800 nm.

        A limit for comparisons: without particles and dissolved matter, and so deep blue.

        Returns
        -------
        Water
            Absorption and scattering of molecules alone.

        See Also
        --------
        uw.medium.Water.jerlov : Natural waters.
        uw.medium.Water.chlorophyll : The same with phytoplankton.

        Notes
        -----
        Mason et al. 2016 and Pope & Fry 1997 (a), Zhang et al. 2009 (b).

        Examples
        --------
        >>> uw.medium.Water.pure().range_nm
        (300.0, 800.0)
        """
        b = builtin_spectrum("pure_sea_water.csv", "scattering", "pure sea water, scattering")
        return cls(
            name="pure sea water",
            a=builtin_spectrum("pure_sea_water.csv", "absorption", "pure sea water, absorption"),
            b=b,
            phase="water",
            molecular=b,
            source="Mason et al. 2016, Appl. Opt. 55, 7163; Pope & Fry 1997, Appl. Opt. 36, 8710; "
            "Zhang et al. 2009, Opt. Express 17, 5698",
        )

    @classmethod
    @checked
    def chlorophyll(cls, mg_m3: float, phase: Phase | None = None) -> Water:
        """Return open-ocean (Case 1) water of a chlorophyll concentration, at 350 to 700 nm.

        For water whose colour comes from phytoplankton, not for coasts with silt or river water. Above 0.3 mg/m^3 its
        light is up to 1.7 times too bright in blue.

        Parameters
        ----------
        mg_m3 : float
            Concentration [mg/m^3], 0.01 to 20.
        phase : Phase, optional
            Phase function of the particles; without it that of Fournier & Forand with the bb/b of Morel & Maritorena
            2001.

        Returns
        -------
        Water
            Its a, b and Kd.

        Raises
        ------
        ParameterError
            If the concentration is outside the models.

        See Also
        --------
        uw.medium.Water.jerlov : Types from clear ocean to turbid coast.
        uw.medium.Water.from_arrays : Measured coefficients.

        Notes
        -----
        a: pure water + particles Ap Chl^Ep (Bricaud et al. 1998) + 20 % of their value at 440 nm as dissolved matter
        with slope 0.014/nm (Morel & Maritorena 2001). b: pure water + 0.416 Chl^0.766 (w/550)^v (Loisel & Morel 1998).
        Kd: Kw + chi Chl^e (Morel & Maritorena 2001, Table 2), nowhere below a. bb/b of the particles: 0.002 + 0.01 (0.5
        - 0.25 log10 Chl).

        Examples
        --------
        >>> uw.medium.Water.chlorophyll(0.3).absorption(440.0).round(3)
        np.float64(0.034)
        """
        if not 0.01 <= mg_m3 <= 20.0:
            raise ParameterError(f"chlorophyll - outside the models (got {mg_m3!r} mg/m^3) - choose 0.01 to 20")
        # Absorption by water, particles and dissolved matter
        table = builtin_table("morel_maritorena2001_kd.csv")
        w = table["wavelength_nm"]
        pure = cls.pure()
        ap = builtin_spectrum("bricaud1998_particles.csv", "ap", "particles")
        ep = builtin_spectrum("bricaud1998_particles.csv", "ep", "particles")
        dissolved = 0.2 * ap(440.0) * mg_m3 ** ep(440.0) * np.exp(-0.014 * (w - 440.0))
        a = pure.absorption(w) + ap(w) * mg_m3 ** ep(w) + dissolved
        # Scattering by particles, and diffuse attenuation, at least absorption
        slope = 0.5 * (np.log10(mg_m3) - 0.3) if mg_m3 < 2.0 else 0.0
        b = pure.scattering(w) + 0.416 * mg_m3**0.766 * (w / 550.0) ** slope
        kd = np.maximum(table["kw"] + table["chi"] * mg_m3 ** table["e"], a)
        name = f"chlorophyll {mg_m3:g} mg/m^3"
        return cls(
            name=name,
            a=Spectrum(f"{name}, absorption", w, a),
            b=Spectrum(f"{name}, scattering", w, b),
            kd=Spectrum(f"{name}, Kd", w, kd),
            phase=phase or particles_of_backscatter(0.002 + 0.01 * (0.5 - 0.25 * float(np.log10(mg_m3)))),
            molecular=Spectrum(f"{name}, molecular scattering", w, pure.scattering(w)),
            source="Morel & Maritorena 2001, J. Geophys. Res. 106, 7163; Bricaud et al. 1998, J. Geophys. Res. 103, "
            "31033; Loisel & Morel 1998, Limnol. Oceanogr. 43, 847",
        )

    @classmethod
    @checked
    def from_arrays(
        cls,
        wavelength_nm: ArrayLike,
        absorption: ArrayLike,
        scattering: ArrayLike,
        diffuse_attenuation: ArrayLike | None = None,
        phase: Phase = ("hg", MEAN_COSINE_SEA),
        name: str = "water",
    ) -> Water:
        """Return water of coefficients at wavelengths.

        For measured coefficients. Molecules are not told apart from particles: `phase` holds for all of b.

        Parameters
        ----------
        wavelength_nm : array_like
            Wavelengths (w,) [nm], ascending.
        absorption, scattering : array_like
            Coefficients (w,) [1/m].
        diffuse_attenuation : array_like, optional
            Kd (w,) [1/m]; without it Lee et al. 2005.
        phase : Phase
            Phase function of all scattering; `phase.Phase` lists them.
        name : str
            Used in messages.

        Returns
        -------
        Water
            Linear between the wavelengths.

        Raises
        ------
        ParameterError
            If lengths differ, or values are out of range.

        See Also
        --------
        uw.medium.Water.from_csv : Reads the coefficients from a file.
        uw.medium.PhaseTable.from_angles : A measured phase function.
        uw.medium.LayeredField.from_profile : Coefficients that change with depth.

        Examples
        --------
        >>> water = uw.medium.Water.from_arrays([450.0, 650.0], [0.02, 0.3], [0.1, 0.08], phase=("hg", 0.92))
        >>> water.attenuation(550.0).round(3)
        np.float64(0.25)
        """
        w = numbers("wavelength_nm", wavelength_nm).astype(np.float64)

        def spectrum(label: str, values: ArrayLike) -> Spectrum:
            label = f"{name}, {label}"
            column = exactly(label, values, numbers(label, values).shape[:1] or w.shape)
            return Spectrum(label, w, column.astype(np.float64))

        kd = None if diffuse_attenuation is None else spectrum("Kd", diffuse_attenuation)
        return cls(name, spectrum("absorption", absorption), spectrum("scattering", scattering), kd, phase)

    @classmethod
    def from_csv(cls, path: str | Path, phase: Phase = ("hg", MEAN_COSINE_SEA)) -> Water:
        r"""Return water of a CSV file with the columns wavelength_nm, absorption, scattering and, if known, kd.

        Columns may also be named wavelength or wl_nm, a and b. Molecules are not told apart from particles: `phase`
        holds for all of b.

        Parameters
        ----------
        path : str or Path
            The file; lines that start with # are comments, coefficients are in 1/m.
        phase : Phase
            Phase function of all scattering.

        Returns
        -------
        Water
            Linear between the wavelengths of the file.

        Raises
        ------
        ParameterError
            If the file cannot be read, a column is missing, or values are out of range.

        See Also
        --------
        uw.medium.Water.from_arrays : Takes arrays.
        uw.medium.PhaseTable.from_csv : Reads a phase function.
        uw.medium.LayeredField.from_csv : Reads coefficients that change with depth.

        Examples
        --------
        >>> with open("water.csv", "w", encoding="utf-8") as file:
        ...     _ = file.write("wavelength_nm,absorption,scattering\n450,0.02,0.10\n650,0.30,0.08\n")
        >>> uw.medium.Water.from_csv("water.csv").absorption(650.0)
        np.float64(0.3)
        """
        advice = "name the columns wavelength_nm, absorption, scattering, kd"
        columns = read_columns(path, ("wavelength_nm", "absorption", "scattering"), advice, _COLUMN)
        water = cls.from_arrays(
            columns["wavelength_nm"], columns["absorption"], columns["scattering"], columns.get("kd"), phase,
            Path(path).name,
        )  # fmt: skip
        return replace(water, source=str(path))


_COLUMN = {"wavelength": "wavelength_nm", "wl_nm": "wavelength_nm", "a": "absorption", "b": "scattering"}


@shared(keep=64)
def _jerlov(water_type: JerlovType, inherent: Inherent, kd: Diffuse | None, phase: Phase | None) -> Water:
    # one object for each type, so that the field solved for it is found again
    types = [name for name in builtin_table(f"{inherent}_absorption.csv") if name != "wavelength_nm"]
    if water_type not in types:
        raise ParameterError(f"water - no such Jerlov type (got {water_type!r}) - take one of {', '.join(types)}")
    chosen = kd or ("solonenko2015" if inherent == "solonenko2015" else "lee2005")
    name = f"Jerlov {water_type}"
    b = builtin_spectrum(f"{inherent}_scattering.csv", water_type, f"{name}, scattering")
    return Water(
        name=name,
        a=builtin_spectrum(f"{inherent}_absorption.csv", water_type, f"{name}, absorption"),
        b=b,
        kd=_kd_table(water_type, chosen),
        phase=phase or ("petzold" if inherent == "solonenko2015" else ("hg", MEAN_COSINE_SEA)),
        molecular=molecular_part(b),
        source=f"a, b: {_CITATION[inherent]}; molecules: {_CITATION['zhang2009']}; Kd: {_CITATION[chosen]}",
    )
