# SPDX-License-Identifier: Apache-2.0
"""The light of stratified water: layers of constant coefficients, solved together by discrete ordinates.

Each layer has the modes of homogeneous water (`transfer.LightField`): half of them fade downwards from its top, half
upwards from its bottom. Their amounts follow from the surface, from radiances that are the same on both sides of every
interface, and from the floor or, in a last layer without end, from modes that fade upwards being none. Nothing is
approximated besides the streams, so equal layers are homogeneous water. Rays gather what each layer that they cross
scatters into them (`ray_field`), less what the layers before it take. The refractive index is that of all layers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PositiveInt

from mr360uw.base.constants import PI, REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import fresnel_from_below
from mr360uw.base.parameters import checked, exactly, numbers
from mr360uw.base.progress import one_blas_thread
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import check_ray, ray_in_water, together
from mr360uw.medium.phase import Mixture, Phase
from mr360uw.medium.ray_field import LambertFloor, RayField, Sky, SurfaceKind, at_surface, bounded, floor_at, length_to
from mr360uw.medium.spectra import read_columns
from mr360uw.medium.transfer import STREAMS_PER_HEMISPHERE, LightField
from mr360uw.types import Array


class LayeredField:
    """The light of water whose coefficients change with depth, at n wavelengths, solved once.

    All results are per unit downwelling irradiance just below the surface. A scene names its profile as `water.layers`.

    Parameters
    ----------
    top_m : array_like
        Depths (L,) [m] at which layers begin, ascending, the first 0; the last layer reaches down to the floor or for
        ever.
    absorption, scattering : array_like
        Coefficients (L,) or (L, n) [1/m] of the layers; absorption above 0, scattering at least 0.
    phase : Phase or list of Phase or ndarray
        Phase function of all layers, see `LightField`; or a list of a mixture of molecules and particles for each.
    surface : {"snell", "none"}
        Flat with Fresnel's reflection, or no change of refractive index.
    sky : "uniform" or tuple or SkyShape
        Light that enters: uniform, or ("sun", y of the direction to the sun in the water, fraction of the downwelling
        irradiance that is its beam), the rest being a uniform sky; or "floor": none, and a floor of radiance 1.
    refractive_index : float
        Index of the water relative to air, for "snell".
    streams : int
        Directions per hemisphere.
    floor : LambertFloor, optional
        Below the top of the last layer; None for deep water.

    Raises
    ------
    ParameterError
        If depths do not ascend, shapes do not fit, or a coefficient is out of range.

    See Also
    --------
    uw.medium.LayeredField.from_profile : Layers of a measured profile.
    uw.medium.LightField : Water that is the same everywhere.

    Notes
    -----
    Plane-parallel radiative transfer by discrete ordinates in layers (Stamnes et al. 1988), the forward peak taken as
    unscattered (Wiscombe 1977).

    Examples
    --------
    >>> field = uw.medium.LayeredField([0.0, 5.0], absorption=[0.05, 0.2], scattering=[0.1, 0.4])
    >>> field.irradiance([5.0, 10.0], 1.0).round(3).tolist()
    [[0.724], [0.19]]
    >>> field.diffuse_attenuation([1.0, 12.0]).round(3).tolist()
    [[0.064], [0.271]]
    """

    @checked
    def __init__(
        self,
        top_m: ArrayLike,
        absorption: ArrayLike,
        scattering: ArrayLike,
        phase: Phase | list[Phase] | list[Mixture] | Array = "petzold",
        surface: SurfaceKind = "snell",
        sky: Sky = "uniform",
        refractive_index: float = REFRACTIVE_INDEX_SEA,
        streams: PositiveInt = STREAMS_PER_HEMISPHERE,
        floor: LambertFloor | None = None,
    ) -> None:
        self.top_m = numbers("top_m", top_m).astype(np.float64)
        if self.top_m.ndim != 1 or not len(self.top_m) or self.top_m[0] != 0.0 or np.any(np.diff(self.top_m) <= 0.0):
            raise ParameterError(
                f"top_m - must ascend from 0 (got {self.top_m.tolist()!r:.60}) - give the depth where each layer begins"
            )
        self.absorption, self.scattering = _of_layers(len(self.top_m), absorption, scattering)
        self._floor_m, self._albedo = floor_at(floor, self.absorption.shape[1])
        self._shining = float(sky == "floor")
        if self._floor_m <= self.top_m[-1] or (self._shining and floor is None):
            raise ParameterError(
                f"floor - must lie below the last layer's top at {self.top_m[-1]:g} m (got {self._floor_m:g} m, sky "
                f"{sky!r:.20}) - move it, or leave layers out"
            )
        each = phase if isinstance(phase, list) and isinstance(phase[0], Mixture) else [phase] * len(self.top_m)
        self._layers = [
            LightField(a, b, one, surface, "uniform" if self._shining else sky, refractive_index, streams)
            for a, b, one in zip(self.absorption, self.scattering, each, strict=True)
        ]
        self._faded = np.array([layer.faded for layer in self._layers])
        with one_blas_thread():
            self._join()
        self.refractive_index, self.level_beam = self._layers[0].refractive_index, self._layers[0].level_beam

    @classmethod
    def from_profile(
        cls, depth_m: ArrayLike, absorption: ArrayLike, scattering: ArrayLike, layers: int = 20, **settings: object
    ) -> Self:
        """Return the light of a profile that is linear between depths, as layers of its means.

        Every layer has the profile's optical depth; the last, from the last depth on, its last coefficients.

        Parameters
        ----------
        depth_m : array_like
            Depths (d,) [m], ascending; above the first the coefficients are those of the first.
        absorption, scattering : array_like
            Coefficients (d,) or (d, n) [1/m] at the depths.
        layers : int
            Layers down to the last depth, even in depth; twice as many have a quarter of the error.
        **settings : object
            Phase function, surface, sky ... of `LayeredField`.

        Returns
        -------
        LayeredField
            The solved field.

        Raises
        ------
        ParameterError
            If depths do not ascend, or shapes do not fit.

        See Also
        --------
        uw.medium.LayeredField.from_csv : Reads the profile from a file.
        uw.medium.Water.from_arrays : Water that is the same everywhere.

        Examples
        --------
        >>> field = uw.medium.LayeredField.from_profile([0.0, 10.0], [0.05, 0.2], [0.1, 0.4], layers=5)
        >>> field.top_m.tolist()
        [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
        """
        return cls(*layer_means(depth_m, absorption, scattering, layers), **settings)  # type: ignore[arg-type]

    @classmethod
    def from_csv(cls, path: str | Path, layers: int = 20, **settings: object) -> Self:
        """Return the light of a profile in a CSV file: a row for each depth and wavelength.

        For the cast of an instrument that was lowered through the water. Phase function and sky are not in the file:
        give them as settings.

        Parameters
        ----------
        path : str or Path
            The file, with the columns depth_m, wavelength_nm, absorption and scattering [1/m]; every depth has the same
            wavelengths, which the results follow in ascending order.
        layers : int
            Layers down to the last depth.
        **settings : object
            Phase function, surface, sky ... of `LayeredField`.

        Returns
        -------
        LayeredField
            The solved field.

        Raises
        ------
        ParameterError
            If the file cannot be read, a column is missing, or depths have different wavelengths.

        See Also
        --------
        uw.medium.LayeredField.from_profile : Takes arrays.
        uw.medium.Water.from_csv : Reads water that is the same everywhere.

        Examples
        --------
        >>> with open("profile.csv", "w", encoding="utf-8") as file:
        ...     _ = file.write("depth_m,wavelength_nm,absorption,scattering\\n0,500,0.05,0.1\\n10,500,0.2,0.4\\n")
        >>> uw.medium.LayeredField.from_csv("profile.csv", layers=2).absorption.ravel().round(4).tolist()
        [0.0875, 0.1625, 0.2]
        """
        depth, _, absorption, scattering = read_profile(path)
        return cls(*layer_means(depth, absorption, scattering, layers, f"{path}, "), **settings)  # type: ignore[arg-type]

    def irradiance(self, depth_m: ArrayLike, normal_up: ArrayLike = 1.0) -> Array:
        """Return the irradiance of a surface in the water, sun included.

        Just below the surface it is 1 for a normal that looks up. Where layers meet it is continuous, and only its
        slope changes.

        Parameters
        ----------
        depth_m : array_like
            Depths (...,) [m], at least 0; below the floor the light stays what it is there.
        normal_up : array_like
            The y components (...,) of the surface's normal: 1 for E_d, -1 for E_u.

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
        uw.medium.LayeredField.diffuse_attenuation : That slope.
        uw.medium.LayeredField.scalar_irradiance : Light from all sides alike.

        Examples
        --------
        >>> field = uw.medium.LayeredField([0.0, 5.0], [0.05, 0.2], [0.1, 0.4])
        >>> field.irradiance(0.0)
        array([1.])
        """
        check_ray(0.0, depth_m, normal_up)
        y, normal = together(depth_m, normal_up)
        y = np.minimum(y, self._floor_m)
        return self._in_layers(y, lambda layer, at: layer.irradiance(y[at], normal[at]))

    def scalar_irradiance(self, depth_m: ArrayLike) -> Array:
        """Return the irradiance of a small sphere, E_0, sun included.

        Light from all directions counts alike, as for plankton. Times the absorption of the layer it is the power that
        a volume of water absorbs.

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
            If a depth is negative.

        See Also
        --------
        uw.medium.LayeredField.irradiance : The irradiance of a plane.

        Examples
        --------
        >>> field = uw.medium.LayeredField([0.0, 5.0], [0.05, 0.2], [0.1, 0.4])
        >>> field.scalar_irradiance(5.0).round(2)
        array([0.94])
        """
        check_ray(0.0, depth_m, 0.0)
        y = np.minimum(np.asarray(depth_m, np.float64), self._floor_m)
        return self._in_layers(y, lambda layer, at: layer.scalar_irradiance(y[at]))

    def diffuse_attenuation(self, depth_m: ArrayLike) -> Array:
        """Return Kd = -d ln E_d/dz.

        It is the rate at which daylight falls at that depth. Light of the sky and of the layers below counts in it, so
        it changes with depth within a layer too.

        Parameters
        ----------
        depth_m : array_like
            Depths (...,) [m], at least 0; at an interface Kd is that of the layer below.

        Returns
        -------
        ndarray
            Kd (..., n) [1/m].

        Raises
        ------
        ParameterError
            If a depth is negative.

        See Also
        --------
        uw.medium.LayeredField.irradiance : The irradiance itself.
        uw.medium.Water.diffuse_attenuation : An estimate without a solved field.

        Examples
        --------
        >>> field = uw.medium.LayeredField([0.0, 5.0], [0.05, 0.2], [0.1, 0.4])
        >>> field.diffuse_attenuation([1.0, 12.0]).round(3).tolist()
        [[0.064], [0.271]]
        """
        check_ray(0.0, depth_m, 0.0)
        y = np.minimum(np.asarray(depth_m, np.float64), self._floor_m)
        slope = self._in_layers(y, lambda layer, at: layer.slope().irradiance(y[at], 1.0))
        return -slope / self.irradiance(y, 1.0)

    def transmittance(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the fraction of light that passes along a ray without being absorbed or scattered.

        A transmissometer measures it. A picture keeps more contrast, as light that turns by small angles still reaches
        the camera.

        Parameters
        ----------
        distance_m : array_like
            Lengths (...,) [m] of the rays, which end at the surface.
        depth_m : array_like
            Depths (...,) [m] at which they begin.
        up : array_like
            The y components (...,) of their directions, -1 to 1.

        Returns
        -------
        ndarray
            Fraction (..., n), exp(-integral of a + b), by Beer and Lambert.

        Raises
        ------
        ParameterError
            If a distance or depth is negative, or `up` outside [-1, 1].

        See Also
        --------
        uw.medium.LayeredField.inscatter : The light that is added.
        uw.medium.Medium.transmittance : The loss in a picture.

        Examples
        --------
        >>> field = uw.medium.LayeredField([0.0, 5.0], [0.05, 0.2], [0.1, 0.4])
        >>> field.transmittance(8.0, 3.0, -1.0).round(4)
        array([0.0202])
        """
        check_ray(distance_m, depth_m, up)
        s, y, mu = together(ray_in_water(distance_m, depth_m, up), depth_m, up)
        return np.exp(-s[..., None] * self.mean(self.absorption + self.scattering, y, np.maximum(y - s * mu, 0.0)))

    def inscatter(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance scattered into camera rays, cut at the surface and at the floor.

        It is the veil before an object at the end of the ray. What is seen behind the water is not in it: `radiance`
        has floor and sky too.

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
            Radiance (..., n) [1/sr], the mean over the azimuth from the sun's.

        Raises
        ------
        ParameterError
            If a distance or depth is negative, or `up` outside [-1, 1].

        See Also
        --------
        uw.medium.LayeredField.transmittance : What is left of the object's light.
        uw.medium.LayeredField.radiance : Light of the whole ray, with what is behind.

        Notes
        -----
        Radiance at the camera = inscatter + `transmittance` times the radiance at the end.

        Examples
        --------
        >>> field = uw.medium.LayeredField([0.0, 5.0], [0.05, 0.2], [0.1, 0.4])
        >>> field.inscatter([2.0, 8.0], depth_m=3.0, up=-0.6).round(4)
        array([[0.0012],
               [0.0039]])
        """
        check_ray(distance_m, depth_m, up)
        s, y, mu = together(ray_in_water(distance_m, depth_m, up), depth_m, up)
        s = np.minimum(s, length_to(self._floor_m, y, mu))
        ends = np.maximum(y - s * mu, 0.0)
        return np.maximum(self.radiance(y, mu) - self.transmittance(s, y, mu) * self.radiance(ends, mu), 0.0)

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance that arrives at a depth; the sun's own beam is not in it.

        This is what a camera sees where no object is: the water, and behind it the floor or, in Snell's window, the
        sky.

        Parameters
        ----------
        depth_m : array_like
            Depths (...,) [m], at least 0.
        up : array_like
            The y components (...,) of the directions that it comes from, -1 to 1.

        Returns
        -------
        ndarray
            Radiance (..., n) [1/sr], the mean over the azimuth from the sun's.

        Raises
        ------
        ParameterError
            If a depth is negative, or `up` outside [-1, 1].

        See Also
        --------
        uw.medium.LayeredField.inscatter : The light that a part of a ray adds.
        uw.medium.LayeredField.irradiance : The light on a surface.

        Examples
        --------
        >>> field = uw.medium.LayeredField([0.0, 5.0], [0.05, 0.2], [0.1, 0.4])
        >>> field.radiance(depth_m=[2.0, 8.0], up=0.0).round(4)
        array([[0.0123],
               [0.0057]])
        """
        return self.rays.radiance(depth_m, up)

    @functools.cached_property
    def rays(self) -> LayeredRays:
        """The light along rays, its forward peak unscattered."""
        return self._rays([layer.rays for layer in self._layers])

    def scattered_by(self, parts: Sequence[Mixture]) -> LayeredRays:
        """Return the light along rays that a part of each layer's scattering brings into them."""
        return self._rays([layer.scattered_by(part) for layer, part in zip(self._layers, parts, strict=True)])

    def _rays(self, layers: list[RayField]) -> LayeredRays:
        lit = np.zeros(len(self._albedo)) if np.isinf(self._floor_m) else self.irradiance(self._floor_m, 1.0)
        return LayeredRays(self, layers, self._floor_m, self._shining + self._albedo / PI * lit)

    def mean(self, coefficient: Array, from_m: ArrayLike, to_m: ArrayLike) -> Array:
        """Return the mean (..., n) of coefficients (L, n) of the layers between two depths (...), or at a depth."""
        a, b = together(from_m, to_m)
        gap = np.abs(b - a)[..., None]
        crossed = np.abs(self._depth_integral(coefficient, b) - self._depth_integral(coefficient, a))
        apart = gap > _LEVEL
        return np.where(apart, crossed / np.where(apart, gap, 1.0), coefficient[self.layer_of(a)])

    def layer_of(self, y: ArrayLike) -> NDArray[np.intp]:
        """Return the number (...) of the layer at depths (...)."""
        return np.asarray(np.searchsorted(self.top_m, y, side="right") - 1)

    # --- solution ----------------------------------------------------------------------------------------------

    def _join(self) -> None:
        """Find the amounts of all layers' modes together: so far each layer has light as if it had no end."""
        first, bottom = self._layers[0], np.append(self.top_m[1:], self._floor_m)
        mu, w, sun_mu = first.mu, first.weight, first.sun_mu
        # Take the free modes of each layer from its top and its bottom, and those that the sun's beam drives in it
        beams = [first.beam * self._beam_left(top) for top in self.top_m]
        free, sun = [], []
        for layer, top, end, beam in zip(self._layers, self.top_m, bottom, beams, strict=True):
            down = replace(layer.ordinates.free, origin_m=np.full(len(mu), top))
            free.append(down if np.isinf(end) else down.beside(down.mirrored(end)))
            sun.append(replace(layer.ordinates.driven(sun_mu, beam), origin_m=np.full(1, top)))
        # Find their amounts, then scale all to a unit of irradiance just below the surface
        reflectance = fresnel_from_below(mu, first.refractive_index)
        entering = (
            first.sky_radiance[:, None] * (1.0 - reflectance) * first.shape.seen_through(mu, first.refractive_index)
        )
        entering, sky = ((1.0 - self._shining) * light for light in (entering, first.sky_radiance))
        lit = self._shining + self._albedo / PI * (first.beam * sun_mu * self._beam_left(np.array(self._floor_m)))
        sent = 2.0 * self._albedo[:, None] * w * mu
        modes = bounded(free, sun, bottom.tolist(), reflectance, entering, sent, lit)
        incident = 2.0 * PI * np.einsum("i,nij->n", w * mu, modes[0].at(0.0)[0]) + first.level_beam
        incident = np.where(self._shining, 1.0, incident)
        for layer, top, beam, of_layer in zip(self._layers, self.top_m, beams, modes, strict=True):
            layer._take(of_layer, beam, sky, incident, top)

    def _in_layers(self, y: Array, light: Callable[[LightField, NDArray[np.bool_]], Array]) -> Array:
        """Return light (..., n) at depths (...). light: gives that of a layer at those of the depths that are in it."""
        layer_of, found = self.layer_of(y), np.empty((*y.shape, self.absorption.shape[1]))
        for number, layer in enumerate(self._layers):
            inside = np.asarray(layer_of == number)
            if np.any(inside):
                found[inside] = light(layer, inside)
        return found

    def _depth_integral(self, coefficient: Array, y: Array) -> Array:
        """Return the integral (..., n) of coefficients (L, n) of the layers from the surface to depths (...)."""
        within = np.clip(y[..., None] - self.top_m, 0.0, np.append(np.diff(self.top_m), np.inf))
        return np.asarray(within @ coefficient)

    def _beam_left(self, y: Array) -> Array:
        """Return the fraction (..., n) of the beam at the surface that reaches depths (...)."""
        return np.exp(-self._depth_integral(self._faded, y) / self._layers[0].sun_mu)


_LEVEL = 1e-9
"""Distance [m] of two depths up to which they are one, and slope up to which a ray is level."""


@dataclass(frozen=True, slots=True, eq=False)
class LayeredRays:
    """Light along rays through layers, each with its own `RayField`. floor_m, floor: depth, radiance (n,) of a floor.

    A ray gains in each layer what that scatters into it, and keeps of what comes into the layer exp(-extinction times
    its length there). So what comes to an interface in a direction follows from the next interface, and a ray's light
    from the first interface that it meets.
    """

    field: LayeredField
    layers: list[RayField]
    floor_m: float
    floor: Array

    @property
    def extinction(self) -> Array:
        """Extinction (L, n) [1/m] of the layers."""
        return np.array([layer.extinction for layer in self.layers])

    def optical_length(self, distance_m: Array, depth_m: Array, up: Array) -> Array:
        """Return the optical length (..., n) of rays that end in the water."""
        end = np.maximum(depth_m - distance_m * up, 0.0)
        return distance_m[..., None] * self.field.mean(self.extinction, depth_m, end)

    def inscatter(self, distance_m: Array, depth_m: Array, up: Array) -> Array:
        """Return the radiance (..., n) scattered into rays that end in the water, above the floor."""
        end, left = np.maximum(depth_m - distance_m * up, 0.0), np.exp(-self.optical_length(distance_m, depth_m, up))
        return self.radiance(depth_m, up) - left * self.radiance(end, up)

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., n) that arrives at depths from the directions `up`, without the sun's beam."""
        check_ray(0.0, depth_m, up)
        y, mu = together(depth_m, up)
        y, tops = np.minimum(y, self.floor_m), self.field.top_m
        toward, which = np.unique(mu, return_inverse=True)
        which, rising, falling = which.reshape(mu.shape), toward > _LEVEL, toward < -_LEVEL
        # Light that comes into each layer, from the surface down and from the floor up
        coming = np.zeros((len(tops), len(toward), len(self.floor)))
        if np.any(rising):
            first, reflected = self.layers[0], self.radiance(0.0, -toward[rising])
            coming[0, rising] = at_surface(toward[rising], first.sky, first.shape, first.index, reflected)
        coming[-1, falling] = self.floor
        for k in range(1, len(tops)):
            coming[k, rising] = self._through(k - 1, tops[k], toward[rising], coming[k - 1, rising])
            coming[-k - 1, falling] = self._through(-k, tops[-k], toward[falling], coming[-k, falling])
        # The last part of each ray, in the layer that it arrives in
        result, layer_of = np.empty((*y.shape, len(self.floor))), self.field.layer_of(y)
        for k in np.unique(layer_of):
            inside = np.asarray(layer_of == k)
            result[inside] = self._through(k, y[inside], mu[inside], coming[k, which[inside]])
        return result

    def _through(self, layer: int, y: ArrayLike, mu: Array, coming: Array) -> Array:
        """Return light (r, n) at depths in a layer, of light that comes into it from directions mu (r,)."""
        if not len(mu):
            return coming
        edge = np.where(mu > 0.0, self.field.top_m[layer], np.append(self.field.top_m[1:], self.floor_m)[layer])
        s = np.divide(y - edge, mu, out=np.full(mu.shape, np.inf), where=np.abs(mu) > _LEVEL)
        rays, y = self.layers[layer], np.broadcast_to(y, mu.shape)
        return rays.inscatter(np.maximum(s, 0.0), y, mu) + np.exp(-rays.extinction * s[:, None]) * coming


def read_profile(path: str | Path) -> tuple[Array, Array, Array, Array]:
    """Return depths (d,) [m], wavelengths (n,) [nm], absorption and scattering (d, n) [1/m] of a CSV file.

    It is as `LayeredField.from_csv` says, which raises the same.
    """
    wanted = ("depth_m", "wavelength_nm", "absorption", "scattering")
    columns = read_columns(path, wanted)
    order = np.lexsort((columns["wavelength_nm"], columns["depth_m"]))
    depth, wavelength, a, b = (columns[name][order] for name in wanted)
    depths, count = np.unique(depth), len(np.unique(wavelength))
    if len(depth) != len(depths) * count or np.any(wavelength.reshape(-1, count) != wavelength[:count]):
        raise ParameterError(
            f"{path} - every depth needs the same wavelengths (got {len(depth)} rows for {len(depths)} depths and "
            f"{count} wavelengths) - fill the table"
        )
    shape = len(depths), count
    return depths, wavelength[:count], a.reshape(shape), b.reshape(shape)


def layer_means(
    depth_m: ArrayLike, absorption: ArrayLike, scattering: ArrayLike, layers: int = 20, where: str = ""
) -> tuple[Array, Array, Array]:
    """Return the tops (L,) and coefficients (L, n), twice, of the layers of `LayeredField.from_profile`.

    where: begins the message of what it raises.
    """
    depth = numbers("depth_m", depth_m).astype(np.float64)
    if depth.ndim != 1 or len(depth) < 2 or depth[0] < 0.0 or np.any(np.diff(depth) <= 0.0) or layers < 1:
        raise ParameterError(
            f"{where}depth_m - must be two depths or more that ascend, and layers one or more (got "
            f"{depth.tolist()!r:.60}, {layers!r}) - sort the profile"
        )
    edge = np.linspace(0.0, depth[-1], layers + 1)
    a, b = (
        np.stack([_means(edge, depth, column) for column in values.T], axis=-1)
        for values in _of_layers(len(depth), absorption, scattering, where)
    )
    return edge, a, b


def _of_layers(count: int, absorption: ArrayLike, scattering: ArrayLike, where: str = "") -> tuple[Array, Array]:
    """Return coefficients (count, n) of both; raise `ParameterError` for other shapes and impossible values."""
    a, b = (numbers(name, x).astype(np.float64) for name, x in (("absorption", absorption), ("scattering", scattering)))
    a, b = (x[:, None] if x.ndim == 1 else x for x in (a, b))
    if a.ndim != 2:
        raise ParameterError(f"absorption - must be (L,) or (L, n) (got shape {a.shape}) - give a row for each depth")
    shape = count, a.shape[1]
    a, b = exactly("absorption", a, shape), exactly("scattering", b, shape)
    if not np.all(a > 0.0) or not np.all(b >= 0.0):
        raise ParameterError(
            f"{where}layers - absorption must be above and scattering at least zero (got {a.min(initial=0.0):g} and "
            f"{b.min(initial=0.0):g} 1/m) - correct the coefficients"
        )
    return a, b


def _means(edge: Array, depth: Array, value: Array) -> Array:
    """Return the means of a linear profile between edges (e,), and the last value below them: (e,)."""
    at = np.unique(np.concatenate([edge, depth]))
    level = np.interp(at, depth, value)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (level[1:] + level[:-1]) * np.diff(at))])
    return np.append(np.diff(np.interp(edge, at, integral)) / np.diff(edge), value[-1])
