# SPDX-License-Identifier: Apache-2.0
"""Phase functions: angular distribution of light after one scattering event, and their Legendre moments.

p(cos) [1/sr] integrates to 1 over the sphere; cos is taken between the directions of travel before and after, forward
= +1. Their Legendre moments chi_l = 2 pi int p P_l dcos (chi_0 = 1, chi_1 = mean cosine) feed the transfer equation.

Sources: Henyey & Greenstein 1941; Fournier & Jonasz 1999 and Mobley et al. 2002; average particle of Petzold 1972 by
Mobley et al. 1993; Zhang et al. 2009 for molecules.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.cache import shared
from mr360uw.base.constants import INV_4PI, PI
from mr360uw.base.parameters import checked, exactly, numbers
from mr360uw.base.sphere import gauss_legendre
from mr360uw.errors import ParameterError
from mr360uw.medium.spectra import builtin_table, read_columns
from mr360uw.types import Array


@checked
@dataclass(frozen=True, slots=True)
class PhaseTable:
    """A phase function of one's own, measured or computed: values at angles, or Legendre moments.

    It stands wherever a phase function is named: `Water.from_csv(path, phase=...)`, `LightField(..., phase=...)`.
    Between angles the logarithm of the value is linear in the logarithm of the angle. Below the first angle it goes on
    as a power of the angle with the slope of the first two, no steeper than -1.9; above the last it stays. It is
    normalised to an integral of 1 over the sphere.

    Parameters
    ----------
    angle_rad : tuple of float
        Scattering angles [rad], ascending, above 0 and up to pi; () for moments.
    value : tuple of float
        Values at the angles, above 0, in any unit.
    moment : tuple of float
        Legendre moments chi_0 = 1, chi_1 = mean cosine, ...; those beyond the last are 0.

    Raises
    ------
    ParameterError
        If angles do not ascend, values are not positive, or the moments are those of no phase function.

    See Also
    --------
    uw.medium.PhaseTable.from_angles : Makes one of measured values.
    uw.medium.Water.from_arrays : Takes one for a water.
    uw.medium.LightField : Takes one for a light field.

    Notes
    -----
    Of moments: p = sum (2 l + 1)/(4 pi) chi_l P_l(cos).

    Examples
    --------
    >>> table = uw.medium.PhaseTable.from_angles([0.1, 1.0, 10.0, 90.0, 180.0], [1767.0, 70.0, 2.5, 0.0023, 0.0034])
    >>> water = uw.medium.Water.from_arrays([450.0, 650.0], [0.02, 0.3], [0.1, 0.08], phase=table)
    >>> bool(water.backscattering(550.0) < 0.02 * water.scattering(550.0))
    True
    """

    angle_rad: tuple[float, ...] = ()
    value: tuple[float, ...] = ()
    moment: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        angle, value, moment = (np.array(given, np.float64) for given in (self.angle_rad, self.value, self.moment))
        # Moments: of a function that is nowhere negative
        if len(moment):
            if len(angle) or len(value) or abs(moment[0] - 1.0) > _MOMENT_ROUNDING or np.max(np.abs(moment)) > 1.0:
                raise ParameterError(
                    f"phase - moments must begin with 1 and lie in [-1, 1] (got {moment.tolist()!r:.60}) - divide them "
                    "by the first, without the factor 2 l + 1"
                )
            low = float(np.min(_series(np.linspace(0.0, PI, _ANGLES_CHECKED), self.moment)))
            if low < -_LEAST_OF_SERIES:
                raise ParameterError(
                    f"phase - moments give a negative phase function (got {low:.3g} 1/sr) - give more of them"
                )
            return
        # A table: angles that ascend, values above 0
        if len(angle) != len(value) or len(angle) < 2 or np.any(np.diff(angle) <= 0.0):
            raise ParameterError(
                "phase - needs two angles or more that ascend, and as many values "
                f"(got {angle.shape} and {value.shape}) - sort the table"
            )
        if angle[0] <= 0.0 or angle[-1] > PI + 1e-9 or np.any(value <= 0.0):
            raise ParameterError(
                "phase - angles must lie in (0, pi] and values above 0 "
                f"(got angles {angle[0]:.3g} to {angle[-1]:.3g} rad, least value {value.min():.3g}) - leave them out"
            )

    @classmethod
    def from_angles(cls, angle_deg: ArrayLike, value: ArrayLike) -> PhaseTable:
        """Return the phase function of values at angles.

        Only the shape of the values counts; how much is scattered is b of the water. Begin at a small angle: in the sea
        half of the light turns by less than 5 degrees, and what lies below the first angle is extrapolated.

        Parameters
        ----------
        angle_deg : array_like
            Scattering angles (n,) [deg], ascending, above 0 and up to 180; 0 is forward.
        value : array_like
            Values (n,), above 0: a phase function [1/sr] or a volume scattering function, in any unit.

        Returns
        -------
        PhaseTable
            For `Water` and `LightField`.

        Raises
        ------
        ParameterError
            If angles do not ascend or values are not positive.

        See Also
        --------
        uw.medium.PhaseTable.from_csv : Reads them from a file.
        uw.medium.PhaseTable.from_moments : Takes a Legendre series.

        Examples
        --------
        >>> len(uw.medium.PhaseTable.from_angles([1.0, 90.0, 180.0], [10.0, 0.1, 0.1]).value)
        3
        """
        angle, value = (exactly(n, x, np.shape(value)) for n, x in (("angle_deg", angle_deg), ("value", value)))
        return cls(tuple(np.radians(angle).ravel().tolist()), tuple(np.asarray(value, np.float64).ravel().tolist()))

    @classmethod
    def from_moments(cls, moment: ArrayLike) -> PhaseTable:
        """Return the phase function of Legendre moments.

        For phase functions of theory, as programs for Mie scattering print them. A sharp forward peak needs many: with
        too few the series turns negative and is refused.

        Parameters
        ----------
        moment : array_like
            Moments (m,), chi_0 = 1 and chi_1 the mean cosine, without the factor 2 l + 1.

        Returns
        -------
        PhaseTable
            For `Water` and `LightField`.

        Raises
        ------
        ParameterError
            If the moments are those of no phase function.

        See Also
        --------
        uw.medium.PhaseTable.from_angles : Takes values at angles.

        Examples
        --------
        >>> rayleigh = uw.medium.PhaseTable.from_moments([1.0, 0.0, 0.1])
        >>> uw.medium.Water.from_arrays([500.0], [0.1], [0.2], phase=rayleigh).backscattering(500.0).round(6)
        np.float64(0.1)
        """
        return cls(moment=tuple(np.asarray(numbers("moment", moment), np.float64).ravel().tolist()))

    @classmethod
    def from_csv(cls, path: str | Path) -> PhaseTable:
        """Return the phase function of a CSV file with the columns angle_deg and phase_function.

        The same file can be named in a scene, as `water.phase`. Only the shape of the values counts.

        Parameters
        ----------
        path : str or Path
            The file; lines that start with # are comments.

        Returns
        -------
        PhaseTable
            For `Water` and `LightField`.

        Raises
        ------
        ParameterError
            If the file cannot be read, a column is missing, or angles do not ascend.

        See Also
        --------
        uw.medium.PhaseTable.from_angles : Takes arrays, and says where they should begin.
        uw.medium.Water.from_csv : Reads absorption and scattering.

        Examples
        --------
        >>> with open("phase.csv", "w", encoding="utf-8") as file:
        ...     _ = file.write("angle_deg,phase_function\\n1,10\\n90,0.1\\n180,0.1\\n")
        >>> uw.medium.PhaseTable.from_csv("phase.csv").value
        (10.0, 0.1, 0.1)
        """
        columns = read_columns(path, ("angle_deg", "phase_function"))
        return cls.from_angles(columns["angle_deg"], columns["phase_function"])

    def __call__(self, theta: ArrayLike) -> Array:
        """Return the phase function [1/sr] at scattering angles [rad]."""
        angle = np.asarray(theta, np.float64)
        return _series(angle, self.moment) if self.moment else _tabulated(angle, self) / _table_norm(self)


_MOMENT_ROUNDING = 1e-6
"""Largest deviation of the first moment from 1: the rounding of printed tables."""
_LEAST_OF_SERIES = 1e-3
"""Negative values [1/sr] that a series may have: a hundredth of the isotropic value, from rounded moments."""
_ANGLES_CHECKED = 721
"""Angles at which a series is looked at for negative values, a quarter of a degree apart."""
_STEEPEST_SLOPE = -1.9
"""Least slope of the continuation to angle 0, above -2, where the integral over the sphere is infinite."""


def _series(theta: Array, moment: tuple[float, ...]) -> Array:
    factor = (2.0 * np.arange(len(moment)) + 1.0) * INV_4PI * np.asarray(moment)
    return np.asarray(np.polynomial.legendre.legval(np.cos(theta), factor))


def _tabulated(theta: Array, table: PhaseTable | None) -> Array:
    """Return the values of a table, for None Petzold's, not normalised."""
    if table is None:
        printed, slope = builtin_table("petzold_average_particle.csv"), _PETZOLD_SLOPE
        log_angle, log_p = np.log(np.radians(printed["angle_deg"])), np.log(printed["phase_function"])
    else:
        log_angle, log_p = np.log(table.angle_rad), np.log(table.value)
        slope = max((log_p[1] - log_p[0]) / (log_angle[1] - log_angle[0]), _STEEPEST_SLOPE)
    x = np.log(np.maximum(theta, 1e-12))
    return np.asarray(np.exp(np.interp(x, log_angle, log_p) + slope * np.minimum(x - log_angle[0], 0.0)))


@shared(keep=64)
def _table_norm(table: PhaseTable | None) -> float:
    theta, weight = _angle_quadrature()
    return float(2.0 * PI * np.sum(weight * _tabulated(theta, table)))


Phase = str | tuple[str, float] | tuple[str, float, float] | PhaseTable
"""A name ("isotropic", "petzold", "water"), ("hg", g), ("fournier-forand", refractive index, Junge slope), or a
table."""

_DEPOLARISATION = 0.039
"""Depolarisation ratio of sea water's molecules (Zhang et al. 2009)."""
_PETZOLD_SLOPE = -1.3467
"""Below 0.1 degree, where there are no measurements, the phase function is continued as angle^-1.3467."""


def henyey_greenstein(cos_theta: ArrayLike, g: ArrayLike) -> Array:
    """Return the Henyey-Greenstein phase function [1/sr] of mean cosine g in (-1, 1)."""
    cos_theta, g = np.asarray(cos_theta, np.float64), np.asarray(g, np.float64)
    # |a - b|^2 of unit vectors, free of cancellation for forward peaks
    d = (1.0 - g) * (1.0 - g) + 2.0 * g * (1.0 - cos_theta)
    return INV_4PI * (1.0 - g * g) / (d * np.sqrt(d))


def molecular(cos_theta: ArrayLike, depolarisation: ArrayLike) -> Array:
    """Return the phase function [1/sr] of molecules with a depolarisation ratio (0 = Rayleigh)."""
    cos_theta, delta = np.asarray(cos_theta, np.float64), np.asarray(depolarisation, np.float64)
    f = (1.0 - delta) / (1.0 + delta)
    return 3.0 * INV_4PI / (3.0 + f) * (1.0 + f * cos_theta * cos_theta)


def _fournier_forand(theta: ArrayLike, index: float, slope: float) -> Array:
    """Return the Fournier-Forand phase function [1/sr] at angles [rad] for particles of a relative refractive index.

    slope: of the Junge size distribution, 3 to 5. The removable singularity at delta = 1 is stepped over.
    """
    nu = 0.5 * (3.0 - slope)
    s2 = np.sin(0.5 * np.asarray(theta, np.float64)) ** 2
    scale = 4.0 / (3.0 * (index - 1.0) ** 2)
    d = scale * np.maximum(s2, 1e-30)
    d = np.where(np.abs(d - 1.0) < 1e-4, 1.0 + 1e-4, d)
    d180 = scale
    dn = d**nu
    first = nu * (1.0 - d) - (1.0 - dn) + (d * (1.0 - dn) - nu * (1.0 - d)) * scale / d
    second = (1.0 - d180**nu) / (4.0 * (d180 - 1.0) * d180**nu) * (3.0 * (1.0 - 2.0 * s2) ** 2 - 1.0)
    return INV_4PI * (first / ((1.0 - d) ** 2 * dn) + second)


@shared(keep=64)
def particles_of_backscatter(ratio: float) -> Phase:
    """Return the Fournier-Forand phase function whose bb/b is `ratio`, 0.002 to 0.05.

    Index and slope lie on the line n = 1.01 + 0.1542 (slope - 3) of Mobley et al. 2002, which bb/b runs along.
    """

    def on_line(slope: float) -> Phase:
        return "fournier-forand", 1.01 + 0.1542 * (slope - 3.0), slope

    low, high = _LINE
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if backscatter_ratio(on_line(middle)) < ratio else (low, middle)
    return on_line(low)


_LINE = (3.05, 4.0)
"""Slopes at the ends of that line: bb/b is 0.0001 and 0.09 there."""


def petzold(theta: ArrayLike) -> Array:
    """Return the average particle phase function [1/sr] at angles [rad], normalised to 1 over the sphere."""
    return _tabulated(np.asarray(theta, np.float64), None) / _table_norm(None)


@functools.cache
def _angle_quadrature() -> tuple[Array, Array]:
    """Nodes theta and weights sin(theta) dtheta on (0, pi): Gauss-Legendre in panels that refine towards 0."""
    edges = np.concatenate([[0.0], np.geomspace(1e-8, 0.02, 60), np.geomspace(0.02, PI, 141)[1:]])
    x, w = gauss_legendre(8)
    half = 0.5 * np.diff(edges)[:, None]
    theta = 0.5 * (edges[:-1] + edges[1:])[:, None] + half * x
    return theta.ravel(), (half * w * np.sin(theta)).ravel()


def check_phase(phase: Phase) -> None:
    """Raise `ParameterError` where a phase function is not one of `Phase` or its numbers have no meaning."""
    if phase in ("isotropic", "petzold", "water") or isinstance(phase, PhaseTable):
        return
    if isinstance(phase, tuple) and len(phase) == 2 and phase[0] == "hg" and -0.99 <= phase[1] <= 0.99:
        return
    if isinstance(phase, tuple) and len(phase) == 3 and phase[0] == "fournier-forand":
        if 1.0 < phase[1] <= 1.35 and 3.0 < phase[2] < 5.0:
            return
        raise ParameterError(
            f"phase - Fournier-Forand out of range (got {phase!r}) - choose an index of 1 to 1.35 and a slope of 3 to 5"
        )
    raise ParameterError(
        f"phase - unknown phase function (got {phase!r}) - take 'isotropic', 'petzold', 'water', ('hg', g) with "
        "|g| <= 0.99, ('fournier-forand', index, slope) or a PhaseTable"
    )


def phase_function(phase: Phase, theta: ArrayLike) -> Array:
    """Return the phase function [1/sr] at scattering angles [rad]."""
    check_phase(phase)
    angle = np.asarray(theta, np.float64)
    if phase == "isotropic":
        return np.full(angle.shape, INV_4PI)
    if phase == "petzold":
        return petzold(angle)
    if phase == "water":
        return molecular(np.cos(angle), _DEPOLARISATION)
    if isinstance(phase, PhaseTable):
        return phase(angle)
    if phase[0] == "hg":
        return henyey_greenstein(np.cos(angle), phase[1])
    return _fournier_forand(angle, phase[1], phase[2])  # type: ignore[misc, arg-type]


@shared(keep=64)
def phase_moments(phase: Phase, count: int) -> Array:
    """Return the Legendre moments chi_0 ... (count,) of a phase function, chi_0 = 1."""
    check_phase(phase)
    order = np.arange(count)
    if phase == "isotropic":
        moments = np.where(order == 0, 1.0, 0.0)
    elif isinstance(phase, PhaseTable) and phase.moment:
        moments = np.zeros(count)
        moments[: len(phase.moment)] = phase.moment[:count]
    elif isinstance(phase, tuple) and phase[0] == "hg":
        moments = np.power(float(phase[1]), order)
    else:
        theta, weight = _angle_quadrature()
        p = weight * phase_function(phase, theta)
        moments = np.polynomial.legendre.legvander(np.cos(theta), count - 1).T @ p
        moments = moments / moments[0]
    moments.setflags(write=False)
    return moments


@shared(keep=64)
def wide_angle_moments(phase: Phase, count: int) -> Array:
    """Return the Legendre moments (count,) of a phase function whose forward peak is cut off level; chi_0 < 1.

    The fraction g^4 of the scattering (g: mean cosine) is cut off. It turns light by so little, below 22 degrees at
    g = 0.92, that it blurs the image of an object rather than dimming it (Potter 1970).
    """
    theta, weight = _angle_quadrature()
    p, level = _level_of_peak(phase)
    if np.isinf(level):
        return phase_moments(phase, count)
    moments = 2.0 * PI * np.polynomial.legendre.legvander(np.cos(theta), count - 1).T @ (weight * np.minimum(p, level))
    moments.setflags(write=False)
    return moments


def wide_angle_function(phase: Phase, theta: ArrayLike) -> Array:
    """Return the phase function [1/sr] at angles [rad] whose forward peak is cut off level, see `wide_angle_moments`.

    Its integral is the fraction of light that is not scattered by small angles.
    """
    _, level = _level_of_peak(phase)
    return np.minimum(phase_function(phase, theta) / _integral(phase), level)


def forward_peak(phase: Phase) -> tuple[Array, Array]:
    """Return angles (n,) [rad] and the fractions (n,), sum 1, that the cut-off forward peak scatters into them.

    All at angle 0 where there is no peak: see `wide_angle_moments`.
    """
    theta, weight = _angle_quadrature()
    p, level = _level_of_peak(phase)
    if np.isinf(level):
        return np.zeros(1), np.ones(1)
    peak = weight * np.maximum(p - level, 0.0)
    return theta[peak > 0.0], peak[peak > 0.0] / peak.sum()


CONE_RAD = 0.25 * PI
"""Scattering angle below which light of a body still arrives near it."""


def forward_cone(phase: Phase) -> tuple[Array, Array, float]:
    """Return angles (n,) [rad] below `CONE_RAD`, the fractions (n,), sum 1, that are scattered into them, and what
    fraction of all scattering that is.
    """
    theta, weight = _angle_quadrature()
    within = theta < CONE_RAD
    light = 2.0 * PI * (weight * phase_function(phase, theta))[within]
    return theta[within], light / light.sum(), float(light.sum() / _integral(phase))


@shared(keep=64)
def _integral(phase: Phase) -> float:
    """Return the integral of a phase function over the sphere, 1 but for the rounding of published numbers."""
    theta, weight = _angle_quadrature()
    return float(2.0 * PI * np.sum(weight * phase_function(phase, theta)))


@shared(keep=64)
def _level_of_peak(phase: Phase) -> tuple[Array, float]:
    """Return a phase function at the quadrature's angles and the value that its peak is cut off at; infinity: none."""
    share = max(mean_cosine(phase), 0.0) ** 4
    theta, weight = _angle_quadrature()
    p = phase_function(phase, theta) / _integral(phase)
    if share < 1e-6:
        return p, np.inf
    low, high, level = 0.0, PI, np.inf
    for _ in range(50):
        middle = 0.5 * (low + high)
        level = float(np.interp(middle, theta, p))
        cut = 2.0 * PI * np.sum(weight * np.maximum(p - level, 0.0))
        low, high = (middle, high) if cut < share else (low, middle)
    return p, level


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Phase functions of particles and molecules together, at n wavelengths.

    particles: their phase function. molecular: (n,) fraction of the scattering that is by molecules. wide: the
    particles' without its forward peak, see `wide_angle_moments`.
    """

    particles: Phase
    molecular: Array
    wide: bool = False

    def moments(self, count: int) -> Array:
        """Return Legendre moments (n, count)."""
        of = wide_angle_moments if self.wide else phase_moments
        molecules, particles = self.shares
        return np.asarray(molecules[:, None] * of("water", count) + particles[:, None] * of(self.particles, count))

    @property
    def shares(self) -> Array:
        """Fractions (2, n) of the scattering that are by molecules and by particles."""
        return np.stack([self.molecular, 1.0 - self.molecular])

    def parts(self, cosine: Array) -> Array:
        """Return the phase functions (..., 2) [1/sr] of molecules and particles, each of integral 1 with its peak."""
        theta = np.arccos(np.clip(cosine, -1.0, 1.0))
        if self.wide:
            particles = wide_angle_function(self.particles, theta)
        else:
            particles = phase_function(self.particles, theta) / _integral(self.particles)
        return np.stack([phase_function("water", theta), particles], axis=-1)


def mean_cosine(phase: Phase) -> float:
    """Return the mean cosine g of the scattering angle."""
    return float(phase_moments(phase, 2)[1])


@shared(keep=64)
def backscatter_ratio(phase: Phase) -> float:
    """Return bb/b, the fraction of scattered light that turns by more than 90 degrees."""
    check_phase(phase)
    if phase == "isotropic":
        return 0.5
    x, w = gauss_legendre(64)
    cosine = 0.5 * (x - 1.0)
    backward = PI * np.sum(w * phase_function(phase, np.arccos(cosine)))
    formula = isinstance(phase, tuple) and phase[0] == "fournier-forand"
    return float(backward / _integral(phase) if formula else backward)


Scatterers = tuple[Callable[[Array], Array], Array]
"""Function of the cosine (...,) of the scattering angle that gives the phase functions (..., k) of k kinds of
scatterers, and the fractions (k, n) of the scattering at n wavelengths that are theirs."""


def without_peak(
    phase: Phase | list[Phase] | Mixture | Array, count: int, orders: int
) -> tuple[Scatterers, Array, Array]:
    """Return phase functions at so many wavelengths n for a transfer equation of some orders (Wiscombe 1977, delta-M).

    phase: one for all wavelengths, a list of one for each, a mixture, or Legendre moments (n, l) or (l,). Result: the
    functions themselves, of moments their series without the last, whose light is unscattered; the fraction (n,) of
    their forward peak; and the Legendre moments (n, orders) of the rest.
    """
    # Several functions or moments: one for each wavelength
    if isinstance(phase, list):
        if len(phase) != count:
            raise ParameterError(f"phase - needs one for each of {count} wavelengths (got {len(phase)}) - give as many")
        for one in phase:
            check_phase(one)
        phase = np.stack([phase_moments(one, orders + 1) for one in phase])
    if isinstance(phase, np.ndarray):
        length = phase.shape[-1]
        moments = np.broadcast_to(exactly("phase", phase, (length,), (count, length)), (count, length))
        if length <= orders or not np.allclose(moments[:, 0], 1.0):
            raise ParameterError(
                f"phase - needs {orders + 1} Legendre moments from 1 on (got {phase.shape}) - give more"
            )
        moments = np.array(moments, np.float64)
        shares = (2 * np.arange(length - 1)[:, None] + 1) * INV_4PI * (moments[:, :-1] - moments[:, -1:]).T
        scatterers: Scatterers = functools.partial(legendre_polynomials, count=length - 1), shares
    else:
        # One function for all
        if not isinstance(phase, Mixture):
            check_phase(phase)
            phase = Mixture(phase, np.zeros(count))
        scatterers = phase.parts, phase.shares
        moments = np.broadcast_to(phase.moments(orders + 1), (count, orders + 1))
    # Take away what the last moment says is peak, and renormalise
    peak = moments[:, orders]
    return scatterers, peak, (moments[:, :orders] - peak[:, None]) / (1.0 - peak[:, None])


def legendre_polynomials(x: Array, count: int, order: int = 0) -> Array:
    """Return P_0 ... (..., count) at x (...,); of an order m > 0 the associated functions, 0 at the degrees below m,
    times sqrt((l - m)!/(l + m)!), by the recurrence that is stable upwards in the degree l.
    """
    x = np.asarray(x, np.float64)
    if order == 0:
        return np.asarray(np.polynomial.legendre.legvander(x, count - 1), np.float64).reshape(*x.shape, count)
    p = np.zeros((*x.shape, count + 1))
    odd = 2.0 * np.arange(order) + 1.0
    p[..., order] = np.sqrt(np.prod(odd / (odd + 1.0))) * np.maximum(1.0 - x * x, 0.0) ** (0.5 * order)
    for degree in range(order + 1, count):
        least, last = (np.sqrt(float(n * n - order * order)) for n in (degree, degree - 1))
        p[..., degree] = ((2.0 * degree - 1.0) * x * p[..., degree - 1] - last * p[..., degree - 2]) / least
    return p[..., :count]
