# SPDX-License-Identifier: Apache-2.0
"""The light field of homogeneous water between a flat surface and a Lambert floor, by discrete ordinates.

Plane-parallel radiative transfer, per unit downwelling irradiance just below the surface. For the
radiance at the nodes mu_i of a quadrature on (0, 1), downwelling I+ and upwelling I-, the sum and the difference obey

    (I+ + I-)' = -P (I+ - I-)        (I+ - I-)' = -Q (I+ + I-)

with symmetric, positive P and Q after scaling by sqrt(mu w); their eigenvectors are the modes exp(-k y) of the field
(Stamnes et al. 1988; symmetric form after Nakajima & Tanaka 1986). By symmetry each mode has a mirror image,
exp(-k (D - y)) with I+ and I- exchanged, which fades upwards from a floor at the depth D; deep water has none of them.
Surface and floor fix the amounts. The forward peak of the phase function is taken as unscattered (delta-M, Wiscombe
1977). Between the nodes the radiance is the integral of the modes' own source function, so every quantity is a sum of
exponentials and every path integral the stable closed form of `closed_form.path_integral`. A beam of the sun is one
more mode, of rate c'/mu_sun; what it scatters directly into a ray follows the phase function itself, with its exact
angle, not what streams resolve of it (TMS, Nakajima & Tanaka 1988). About the sun the rest of the light is a sum of
orders cos(m azimuth), each solved alike with associated Legendre functions; no order above 0 meets the floor, and means
over the azimuth need order 0 alone.
"""

from __future__ import annotations

import copy
import functools
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import PositiveInt

from mr360uw.base.constants import PI, REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import critical_cosine, fresnel_from_below
from mr360uw.base.parameters import checked, common_shape, numbers
from mr360uw.base.progress import one_blas_thread
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import check_ray, ray_in_water, together
from mr360uw.medium.phase import Mixture, Phase, Scatterers, legendre_polynomials, without_peak
from mr360uw.medium.ray_field import (
    LambertFloor,
    Modes,
    Ordinates,
    RayField,
    Sky,
    SkyShape,
    SurfaceKind,
    bounded,
    cosine_kernel,
    floor_at,
    index_below,
    nodes,
    scattered_beam,
    sky_parts,
)
from mr360uw.types import Array

STREAMS_PER_HEMISPHERE = 32
"""Directions per hemisphere: irradiances are right to 2e-4. Twice as many take eight times as long to solve."""
_NEGLIGIBLE = 2e-3
"""Light of an order of cos(m azimuth) over that of order 0 from which on further orders are left out: high suns have 10
to 15, low ones 40, and radiances are right to 0.2 %. Half as much costs two more."""


class LightField:
    """The light in water for n sets of coefficients, solved once.

    All results are per unit downwelling irradiance just below the surface.

    Parameters
    ----------
    absorption, scattering : array_like
        Coefficients (n,) or one number [1/m]; absorption above 0, scattering at least 0.
    phase : Phase or list of Phase or Mixture or ndarray
        Phase function of all coefficients, see `Water`, or a list of one for each; or Legendre moments (m,) or (n, m),
        chi_0 = 1. Of lists and moments the streams' moments are used alone.
    surface : {"snell", "none"}
        Flat with Fresnel's reflection, or no change of refractive index.
    sky : "uniform" or tuple or SkyShape
        Light that enters: uniform, or ("sun", y of the direction to the sun in the water, fraction of the downwelling
        irradiance that is its beam), the rest being a uniform sky.
    refractive_index : float
        Index of the water relative to air, 1 to 4, for "snell".
    streams : int
        Directions per hemisphere.
    floor : LambertFloor, optional
        None for deep water; below it the light stays what it is there.

    Raises
    ------
    ParameterError
        If a coefficient or an index is out of range, or moments are too few.

    See Also
    --------
    uw.medium.LayeredField : Water whose coefficients change with depth.
    uw.medium.Medium : The light as a camera sees it.
    uw.datasets.of_light_field : Results as labelled arrays.

    Notes
    -----
    Plane-parallel radiative transfer by discrete ordinates (Stamnes et al. 1988; symmetric form after Nakajima & Tanaka
    1986), the forward peak taken as unscattered (Wiscombe 1977), the beam's own scattering by the phase function itself
    (Nakajima & Tanaka 1988).

    Examples
    --------
    >>> field = uw.medium.LightField([0.05, 0.3], [0.1, 0.1], phase="petzold")
    >>> field.irradiance(depth_m=5.0, normal_up=1.0).round(3)
    array([0.724, 0.164])
    """

    @checked
    def __init__(
        self,
        absorption: ArrayLike,
        scattering: ArrayLike,
        phase: Phase | list[Phase] | Mixture | Array = "petzold",
        surface: SurfaceKind = "snell",
        sky: Sky = "uniform",
        refractive_index: float = REFRACTIVE_INDEX_SEA,
        streams: PositiveInt = STREAMS_PER_HEMISPHERE,
        floor: LambertFloor | None = None,
    ) -> None:
        # Check the coefficients, one for each wavelength
        if len(common_shape(absorption=absorption, scattering=scattering)) > 1:
            raise ParameterError(
                f"light field - coefficients must be (n,) or one number (got {np.shape(absorption)} and "
                f"{np.shape(scattering)}) - flatten them"
            )
        both = together(np.atleast_1d(absorption), np.atleast_1d(scattering))
        self.absorption, self.scattering = (np.array(x) for x in both)
        if not np.all(self.absorption > 0.0) or not np.all(self.scattering >= 0.0):
            raise ParameterError(
                f"light field - absorption must be above and scattering at least zero "
                f"(got {np.min(self.absorption):g} and {np.min(self.scattering):g} 1/m) - correct the coefficients"
            )
        # Set up surface, phase functions without their peak, floor and quadrature; then solve
        self.refractive_index = index_below(surface, refractive_index)
        self._scatterers, self._peak, self._chi = without_peak(phase, len(self.absorption), 2 * streams)
        self._floor_m, self._albedo = floor_at(floor, len(self.absorption))
        self.mu, self.weight = nodes(streams, critical_cosine(self.refractive_index))
        if sky == "floor" and floor is None:
            raise ParameterError("floor - is the only light of sky 'floor' (got none) - give one")
        self._shining = float(sky == "floor")
        self.shape = sky if isinstance(sky, SkyShape) else SkyShape()
        self._solve(*sky_parts(sky))

    def _solve(self, sun_mu: float, sun_share: float) -> None:
        mu, w, index = self.mu, self.weight, self.refractive_index
        entering = (1.0 - fresnel_from_below(mu, index)) * self.shape.seen_through(mu, index)
        passed = 2.0 * PI * np.sum(w * mu * entering)
        of_sky, beam = 1.0 - sun_share - self._shining, np.full(len(self.absorption), sun_share / sun_mu)
        self.sun_mu = sun_mu
        self._azimuth_rad: float | Array | None = None
        self._azimuths = 1
        self._only: int | Literal["beam"] | None = None
        self._most_orders = self._chi.shape[1] - 1
        self.ordinates = self._ordinates(0)
        modes = self._modes(self.ordinates, beam, of_sky * entering / passed)
        incident = np.ones(len(beam))
        if not self._shining:
            incident = 2.0 * PI * np.einsum("i,nij->n", w * mu, modes.at(0.0)[0]) + sun_share
        self._take(modes, beam, of_sky / passed, incident)

    def _take(self, modes: Modes, beam: Array, sky: Array | float, incident: Array, top_m: float = 0.0) -> None:
        """Make modes, the irradiance (n,) across the sun's beam at a depth, and the radiance (n,) of the sky as
        `RayField` has it, the light that is the same at all azimuths, all over an irradiance (n,).
        """
        moments = self.ordinates.moments(modes) / incident[:, None, None]
        self._even = replace(modes.times(1.0 / incident[:, None]), moments=moments)
        self.beam, self.sky_radiance, self._top_m = beam / incident, sky / incident, top_m

    def _ordinates(self, order: int) -> Ordinates:
        """Return the coupling of light that varies as cos(order azimuth)."""
        scattering = (2 * np.arange(self._chi.shape[1]) + 1) * self._chi * (self.faded - self.absorption)[:, None]
        with one_blas_thread():
            return Ordinates(self.mu, self.weight, self.faded, scattering, order)

    def _modes(self, water: Ordinates, beam: Array, from_above: Array) -> Modes:
        """Return the modes of light between surface and floor.

        beam: (n,) irradiance across the sun's beam just below the surface. from_above: (i,) radiance that enters.
        """
        # A floor lights all azimuths alike
        level = float(water.order == 0)
        albedo, shining = level * self._albedo, level * self._shining
        with one_blas_thread():
            free, of_sun = water.free, water.driven(self.sun_mu, beam)
            both = free if np.isinf(self._floor_m) else free.beside(free.mirrored(self._floor_m))
            lit = shining + albedo / PI * (beam * self.sun_mu) * np.exp(-of_sun.rate[:, 0] * self._floor_m)
            reflectance = fresnel_from_below(self.mu, self.refractive_index)
            sent = 2.0 * albedo[:, None] * self.weight * self.mu
            (modes,) = bounded([both], [of_sun], [self._floor_m], reflectance, from_above, sent, lit)
        return modes

    @functools.cached_property
    def _around(self) -> dict[int, Modes]:
        """The light of every order of cos(m azimuth) that counts, that of order 0, which has the beam's mode, last."""
        around: dict[int, Modes] = {}
        if np.any(self.beam > 0.0):
            mean, dark, seen = self._scattered(0, self._even), np.zeros(len(self.mu)), 0
            for order in range(1, self._most_orders + 1):
                water = self._ordinates(order)
                modes = self._modes(water, self.beam, dark)
                around[order] = replace(modes, moments=water.moments(modes))
                if np.any(self._scattered(order, around[order]) > _NEGLIGIBLE * mean):
                    seen = order
                elif order > seen + 1:  # two in a row: the first of molecules hardly has any light, the second has
                    break
        return around | {0: self._even}

    def _scattered(self, order: int, light: Modes) -> Array:
        """Return how much of an order's light (n, k) is scattered into directions, where the beam is 1/e of its light.

        Into Snell's window little is: there `models.FieldModel` leaves out the light of small angles.
        """
        mu = self.mu[self.mu <= (critical_cosine(self.refractive_index) or 1.0)]
        degree = np.arange(self._chi.shape[1])
        legendre = legendre_polynomials(np.append(mu, -mu), len(degree), order)
        depth = np.minimum(self.sun_mu / self.faded, self._floor_m)[:, None]
        moments = np.einsum("nlj,nj->nl", light.moments, np.exp(-light.rate * (depth - light.origin_m)))
        return np.abs((2 * degree + 1) * self._chi * moments @ legendre.T)

    @property
    def azimuth_orders(self) -> tuple[int, ...]:
        """Orders of cos(m azimuth) whose light is not negligible."""
        return tuple(self._around)

    @checked
    def up_to_order(self, most: int) -> LightField:
        """Return the same light with fewer `azimuth_orders`, for drafts: none above `most`."""
        other = copy.copy(self)
        other.__dict__.pop("_around", None)
        other._most_orders = min(most, self._most_orders)
        return other

    @checked
    def at_azimuth(self, azimuth_rad: float, only: int | Literal["beam"] | None = None) -> LightField:
        """Return the same light seen at an azimuth from the sun's, to which radiances and in-scatter then belong.

        Without it they are means over the azimuth. The light that the beam scatters directly keeps its angle to the sun
        exactly; what was scattered before has the `azimuth_orders`. only: one of the parts that add up to the whole: an
        order m of them, or what the beam scatters directly.
        """
        return self._part(float(azimuth_rad), only)

    def beam_at(self, azimuth_rad: Array) -> LightField:
        """Return what the beam scatters directly at azimuths (a,) from the sun's, in place of n wavelengths those of
        one azimuth after those of the other.
        """
        return self._part(azimuth_rad, "beam")

    def _part(self, azimuth_rad: float | Array, only: int | Literal["beam"] | None) -> LightField:
        """Return the same light, of which a part is seen."""
        _ = self._around  # for all azimuths
        other = copy.copy(self)
        for of_azimuth in ("rays", "_floor_radiance"):
            other.__dict__.pop(of_azimuth, None)
        other._azimuth_rad, other._azimuths, other._only = azimuth_rad, np.size(azimuth_rad), only
        return other

    @property
    def _shown(self) -> dict[int, Modes]:
        """The light of the orders that are seen."""
        if self._azimuth_rad is None:
            return {0: self._even}
        return {m: light for m, light in self._around.items() if self._only in (None, m)}

    @functools.cached_property
    def rays(self) -> RayField:
        """The light along rays, its forward peak unscattered."""
        return self._rays(self._chi * (1.0 - self._peak[:, None]), self._scatterers)

    @checked
    def scattered_by(self, part: Mixture) -> RayField:
        """Return the light along rays that a part of the scattering brings into them; the rest is taken as none."""
        return self._rays(part.moments(self._chi.shape[1]), (part.parts, part.shares))

    def _rays(self, moments: Array, scatterers: Scatterers) -> RayField:
        """Return the light along rays that moments (n, l) scatter into them, and scatterers that of the beam."""
        factor = 0.5 * (2 * np.arange(moments.shape[1]) + 1) * moments * self.scattering[:, None]
        kinds, shares = scatterers
        of_beam = functools.partial(scattered_beam, (kinds, shares * self.scattering * self.beam), self.sun_mu)
        # All that is seen, as modes; of the beam alone the last of them, without light
        shown, last = self._shown, self._even
        rates, origins = [light.rate for light in shown.values()], [light.origin_m for light in shown.values()]
        if not shown:
            rates, origins = [np.tile(last.rate[:, -1:], (self._azimuths, 1))], [last.origin_m[-1:]]
        return RayField(
            extinction=np.tile(self.absorption + self.scattering * moments[:, 0], self._azimuths),
            rate=np.concatenate(rates, axis=1),
            origin_m=np.concatenate(origins),
            source={order: factor[..., None] * light.moments for order, light in shown.items()},
            sky=self.sky_radiance if self._only in (None, 0) else np.zeros(self._azimuths * len(self.absorption)),
            shape=self.shape,
            index=self.refractive_index,
            floor_m=self._floor_m,
            floor=self._floor_radiance,
            of_beam=of_beam if np.any(self.beam > 0.0) and self._only in (None, "beam") else None,
            azimuth_rad=self._azimuth_rad,
        )

    @functools.cached_property
    def _floor_radiance(self) -> Array:
        """Radiance (n,) of the floor, 0 without."""
        if np.isinf(self._floor_m) or self._only not in (None, 0):
            return np.zeros(self._azimuths * len(self.absorption))
        return np.asarray(self._shining + self._albedo / PI * self.irradiance(self._floor_m, 1.0))

    def inscatter(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance scattered into camera rays, cut at the surface.

        Here every turn takes light from the object behind, as in exp(-c S). `Medium.veil` leaves it what turns by small
        angles, as a picture does, and adds less.

        Parameters
        ----------
        distance_m : array_like
            Lengths (...,) [m] of the rays, which may be infinite.
        depth_m : array_like
            Depths (...,) [m] of the camera, at least 0.
        up : array_like
            The y components (...,) of the view directions, -1 to 1.

        Returns
        -------
        ndarray
            Radiance (..., n) [1/sr].

        Raises
        ------
        ParameterError
            If a distance or depth is negative, or `up` outside [-1, 1].

        See Also
        --------
        uw.medium.Medium.veil : The same for pictures, in RGB.
        uw.medium.LightField.radiance : Light of the whole ray, with what is behind.
        uw.medium.multiple_scattering : A closed form for it.

        Notes
        -----
        Radiance at the camera = inscatter + exp(-c S) times the radiance at the end, c = a + b.

        Examples
        --------
        >>> field = uw.medium.LightField([0.1], [0.2], phase="isotropic")
        >>> field.inscatter([0.0, 5.0], depth_m=5.0, up=0.0).round(4)
        array([[0.    ],
               [0.0238]])
        """
        s, y, mu = together(ray_in_water(distance_m, depth_m, up), depth_m, up)
        # light of the forward peak: lost from the ray at c, put back by the scattering of what lies behind
        peak = self.scattering * self._peak
        regained = np.exp(-self.rays.extinction * s[..., None]) * -np.expm1(-peak * s[..., None])
        return self.rays.inscatter(s, y, mu) + regained * self.radiance(np.maximum(y - s * mu, 0.0), mu)

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance that arrives at a depth; the sun's own beam is not in it.

        This is what a camera sees where no object is: water and floor, and in Snell's window the sky. With a sun it is
        the mean over the azimuth, unless `at_azimuth` has chosen one.

        Parameters
        ----------
        depth_m : array_like
            Depths (...,) [m], at least 0.
        up : array_like
            The y components (...,) of the directions that it comes from, -1 to 1.

        Returns
        -------
        ndarray
            Radiance (..., n) [1/sr].

        Raises
        ------
        ParameterError
            If a depth is negative, or `up` outside [-1, 1].

        See Also
        --------
        uw.medium.LightField.inscatter : The light that a part of a ray adds.
        uw.medium.LightField.irradiance : The light on a surface.
        uw.datasets.of_light_field : Results as labelled arrays.

        Examples
        --------
        >>> field = uw.medium.LightField([0.1], [0.2], phase="isotropic")
        >>> field.radiance(depth_m=5.0, up=[-1.0, 0.0]).round(4)
        array([[0.0165],
               [0.0306]])
        """
        return self.rays.radiance(depth_m, up)

    def irradiance(self, depth_m: ArrayLike, normal_up: ArrayLike) -> Array:
        """Return the irradiance of a surface in the water, sun included.

        Just below the surface it is 1 for a normal that looks up, as all results are per unit of that. Times albedo/pi
        it is the radiance of a diffuse surface.

        Parameters
        ----------
        depth_m : array_like
            Depths (...,) [m], at least 0.
        normal_up : array_like
            The y components (...,) of the surface's normal: 1 for downwelling E_d, -1 for upwelling E_u, 0 for a
            vertical plane, averaged over its azimuth.

        Returns
        -------
        ndarray
            Irradiance (..., n) [1].

        Raises
        ------
        ParameterError
            If a depth is negative, or a normal outside [-1, 1].

        See Also
        --------
        uw.medium.LightField.scalar_irradiance : Light from all sides alike.
        uw.medium.LightField.radiance : Light from one direction.

        Examples
        --------
        >>> field = uw.medium.LightField([0.1], [0.2])
        >>> field.irradiance([0.0, 10.0], 1.0).round(3)
        array([[1.   ],
               [0.266]])
        """
        check_ray(0.0, depth_m, normal_up)
        y, normal = together(depth_m, normal_up)
        y = np.minimum(y, self._floor_m)
        normals, place = np.unique(normal, return_inverse=True)  # tables ask for few normals at many depths
        down = cosine_kernel(self.mu, normals[:, None]) * self.weight
        up = cosine_kernel(-self.mu, normals[:, None]) * self.weight
        modes = down @ self._even.down + up @ self._even.up
        depths, at = np.unique(y, return_inverse=True)
        place, at, fall = place.ravel(), at.ravel(), self._fall(depths)
        diffuse = np.empty((y.size, len(self.absorption)))
        for number in range(len(normals)):
            of = np.flatnonzero(place == number)
            diffuse[of] = np.einsum("nj,ynj->yn", modes[:, number], fall[at[of]])
        diffuse = diffuse.reshape(*y.shape, len(self.absorption))
        direct = cosine_kernel(np.array(self.sun_mu), normal)[..., None] / (2.0 * PI)
        return diffuse + self.beam * direct * np.exp(-self.faded / self.sun_mu * (y - self._top_m)[..., None])

    @property
    def level_beam(self) -> Array:
        """Irradiance (n,) of a level plane just below the surface that is the sun's beam."""
        return np.asarray(self.beam * self.sun_mu)

    def scalar_irradiance(self, depth_m: ArrayLike) -> Array:
        """Return the irradiance of a small sphere, E_0, sun included.

        Light from all directions counts alike, as for plankton. Times the absorption it is the power that a volume of
        water absorbs.

        Parameters
        ----------
        depth_m : array_like
            Depths (...,) [m], at least 0.

        Returns
        -------
        ndarray
            Irradiance (..., n) [1].

        Raises
        ------
        ParameterError
            If a depth is not finite.

        See Also
        --------
        uw.medium.LightField.irradiance : The irradiance of a plane.

        Examples
        --------
        >>> field = uw.medium.LightField([0.1], [0.2])
        >>> field.scalar_irradiance([0.0, 10.0]).round(3)
        array([[1.251],
               [0.353]])
        """
        y = np.minimum(numbers("depth_m", depth_m).astype(np.float64, copy=False), self._floor_m)
        direct = self.beam * np.exp(-self.faded / self.sun_mu * (y - self._top_m)[..., None])
        return 2.0 * PI * np.sum(self._even.moments[:, 0] * self._fall(y), axis=-1) + direct

    def slope(self) -> LightField:
        """Return the change of the irradiances with depth [1/m], as light."""
        other, even = copy.copy(self), self._even
        other._even = replace(even.times(-even.rate), moments=even.moments * -even.rate[:, None])
        other.beam = self.beam * -self.faded / self.sun_mu
        return other

    @property
    def faded(self) -> Array:
        """Attenuation (n,) [1/m] of the beam and of rays, without the forward peak."""
        return np.asarray(self.absorption + self.scattering * (1.0 - self._peak))

    def _fall(self, depth_m: Array) -> Array:
        """Return the modes (..., n, j) at depths over their amounts."""
        return np.exp(-self._even.rate * (depth_m[..., None, None] - self._even.origin_m))
