# SPDX-License-Identifier: Apache-2.0
"""Transmittance and veil of a water as a sensor sees them, in linear RGB.

Everything is per unit downwelling irradiance just below the surface, with the spectrum of the illuminant. `scaled`
multiplies the veil by a gain, to match the exposure of a plate.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.constants import BRIGHTEST_LOG, REFRACTIVE_INDEX_SEA
from mr360uw.base.parameters import checked, common_shape, exactly, number
from mr360uw.base.progress import one_blas_thread
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import CONTRAST_LENGTHS, check_ray, ray_in_water, visibility_m
from mr360uw.medium.lookup import BandModel, beam_tables, fitted_formation, lengths, medium_table
from mr360uw.medium.models import (
    CLOSED_FORMS,
    FormationModel,
    LayeredModel,
    LayeredWater,
    SpectralMode,
    SpectralModel,
    spectral_model,
)
from mr360uw.medium.ray_field import LambertFloor, Sky, SurfaceKind
from mr360uw.medium.spectra import DEFAULT_ILLUMINANT, DEFAULT_SENSOR, Sensor
from mr360uw.medium.water import Water
from mr360uw.medium.wavelengths import Bands, Rule, bands
from mr360uw.types import Array, Floats, MediumTable

Mode = Literal["kd", "kd+", "table", "plate", "rgb", "koschmieder", "akkaynak-treibitz"]
MODES: tuple[Mode, ...] = get_args(Mode)

RGB_NM = (650.0, 550.0, 450.0)
"""Wavelengths [nm] of mode `rgb`, one for each channel."""
DEFAULT_BANDS = 61
"""Number of wavelengths: 5 nm apart over 400 to 700 nm. Twice as many cost nothing per pixel."""
_SPECTRAL: dict[Mode, SpectralMode] = {"kd": "kd", "rgb": "kd", "kd+": "kd+", "table": "table", "plate": "table"}
_FORMATIONS: tuple[Mode, ...] = ("koschmieder", "akkaynak-treibitz")
SOLVED: tuple[Mode, ...] = ("table", "plate")
"""Modes of the solved light field."""
_TINY = 1e-300  # below the light of any depth
_FAR_LENGTHS = 10.0
"""Ways, over the length of the tables, behind which nothing is seen."""


class Medium:
    """Transmittance and veil of a water as a sensor sees them, in linear RGB.

    Everything is per unit downwelling irradiance just below the surface, with the spectrum of the illuminant.

    Parameters
    ----------
    water : Water
        The water; a `LayeredWater` for the modes "table" and "plate", which see its layers.
    sensor : Sensor, optional
        The sensor; without it the default camera.
    mode : {"kd", "kd+", "table", "plate", "rgb", "koschmieder", "akkaynak-treibitz"}
        Model of the light between camera and object: "kd", the published closed form (Monzon et al. 2022); "kd+", the
        same with Gershun's factor; "table", the solved light field; "plate", the same, and scenes take the veil of long
        ways from their plate; "rgb", the closed form at three wavelengths; the last two have one attenuation per
        channel for object and veil, or one each (Akkaynak & Treibitz 2018), fitted to the solved field.
    camera_depth_m : float
        Depth [m] of the camera, above 0 and up to 1000.
    band_count : int
        Number of wavelengths, see `bands`.
    rule : {"rectangle", "integrated", "fitted"}
        How they are chosen, see `bands`.
    illuminant : str
        Light that white is balanced for.
    surface : {"snell", "none"}
        See `LightField`.
    sky : "uniform" or tuple or SkyShape
        See `LightField`.
    refractive_index : float
        Index of the water relative to air.
    formation : FormationModel, optional
        Constants of the modes "koschmieder" and "akkaynak-treibitz" instead of fitted ones.
    floor_m : float, optional
        Depth [m] of a floor, for solved fields; `lit_by_floor` says how bright it is.

    Raises
    ------
    ParameterError
        If an argument is not known or out of range.

    See Also
    --------
    uw.medium.Water : The coefficients.
    uw.medium.fit_gain : Brings the veil to the exposure of a plate.
    uw.datasets.of_medium : Results as labelled arrays.

    Examples
    --------
    >>> medium = uw.medium.Medium(uw.medium.Water.jerlov("IB"), mode="kd", camera_depth_m=5.0)
    >>> medium.veil(distance_m=8.0, depth_m=5.0, up=0.2).round(4)
    array([0.0064, 0.0177, 0.0243])
    """

    @checked
    def __init__(
        self, water: Water, sensor: Sensor | None = None, mode: Mode = "table", camera_depth_m: float = 5.0, *,
        band_count: int = DEFAULT_BANDS, rule: Rule = "rectangle", illuminant: str = DEFAULT_ILLUMINANT,
        surface: SurfaceKind = "snell", sky: Sky = "uniform", refractive_index: float = REFRACTIVE_INDEX_SEA,
        formation: FormationModel | None = None, floor_m: float | None = None,
    ) -> None:  # fmt: skip
        # Check the arguments that the types do not
        if formation is not None and mode not in _FORMATIONS:
            raise ParameterError(f"formation - is for modes {', '.join(_FORMATIONS)} (got {mode!r}) - leave it out")
        if not 0.0 < camera_depth_m <= 1000.0:
            raise ParameterError(
                f"camera_depth_m - must be in the water (got {camera_depth_m!r}) - give 0.01 to 1000 m"
            )
        # Keep what the light depends on; the bands are found once they are needed
        self.water, self.sensor, self.mode = water, sensor or Sensor.camera(DEFAULT_SENSOR), mode
        self.camera_depth_m = float(camera_depth_m)
        self.between_m: tuple[float, ...] = ()
        self.gain: Array = np.ones(3)
        self.floor_m = floor_m if _SPECTRAL.get(mode) == "table" else None
        self.floor_radiance: Array = np.zeros(3)
        self.shade, self.rough = 0.0, False
        self._radiances: dict[tuple[str, bytes], Array] = {}
        self.illuminant = illuminant
        self.surface: SurfaceKind = surface
        self.sky: Sky = sky
        self.refractive_index = refractive_index
        self._spectral_bands = functools.partial(bands, band_count, self.sensor, rule, illuminant)
        self.formation = formation
        one_each = mode in ("rgb", *_FORMATIONS)
        self.bands = Bands(np.array(RGB_NM), np.eye(3), "one a channel") if one_each else self._spectral_bands()

    @functools.cached_property
    def model(self) -> SpectralModel:
        """The model at the bands' wavelengths, solved at first use."""
        if self.formation is not None:
            return self.formation
        if self.mode in _FORMATIONS:
            bands = self._spectral_bands()
            solved = BandModel(self.model_at(bands.wavelength_nm, "table"), bands)
            return fitted_formation(solved, self.camera_depth_m, one_attenuation=self.mode == "koschmieder")
        return self.model_at(self.bands.wavelength_nm, _SPECTRAL[self.mode])

    @checked
    def model_at(self, wavelength_nm: ArrayLike, mode: SpectralMode) -> SpectralModel:
        """Return the model of the same light at any wavelengths [nm]."""
        floor = None if self.floor_m is None else LambertFloor(self.floor_m, (0.0,))
        return spectral_model(
            self.water, wavelength_nm, mode, self.surface, self.sky, self.refractive_index, floor
        )  # fmt: skip

    @functools.cached_property
    def light(self) -> BandModel:
        """The model's light in the sensor's RGB, without gain."""
        return BandModel(self.model, self.bands)

    @functools.cached_property
    def length_m(self) -> float:
        """Length L [m] of the tables' coordinates: the distance over which the light at the camera falls to 1/e."""
        return self.light.fading_length_m(self.camera_depth_m)

    @functools.cached_property
    def table(self) -> MediumTable:
        """The tables that shading reads, veil within the gamut and times the gain; made at first use."""
        table = self.unit_table
        veil = table.veil * self.gain
        if table.glow is not None:
            veil = veil + table.glow * np.minimum(self.floor_radiance, self.gain * self._most_glow)
        if self.shade:
            veil = veil * self._lit(lengths(veil.shape[1], table.length_m))
        return replace(table, veil=np.minimum(veil, np.exp(BRIGHTEST_LOG)).astype(np.float32))

    @functools.cached_property
    def unit_table(self) -> MediumTable:
        """The same tables without the gain and the floor's light, which change with every frame."""
        model = _SPECTRAL.get(self.mode, self.mode)
        # a beam by itself has no share in the floor's light, which is added to that of a sky
        beam_alone = isinstance(self.sky, tuple) and self.sky[2] == 1.0
        glow = None if self.floor_m is None or beam_alone else self._glow
        with one_blas_thread():
            of_light = self.light, self.camera_depth_m, self.length_m, self.unit_veil
            table = medium_table(*of_light, model, glow, rough=self.rough)
        if table.glow is not None:
            table = replace(table, glow=table.glow - table.veil * self.glow_level)
        return replace(table, refractive_index=self.refractive_index)

    # --- at the wavelengths of the bands ---------------------------------------------------------------------

    @checked
    def spectral_transmittance(self, distance_m: ArrayLike) -> Array:
        """Return the factor (..., n) on an object's radiance at the bands' wavelengths, in the camera's layer."""
        s = np.asarray(distance_m, np.float64)[..., None]
        return np.exp(-self.model.extinction * np.minimum(s, 1e9))

    def spectral_veil(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., n) added to a camera ray at the bands' wavelengths, without gain."""
        check_ray(distance_m, depth_m, up)
        return self.model.inscatter(ray_in_water(distance_m, depth_m, up), depth_m, up)

    # --- in linear RGB ---------------------------------------------------------------------------------------

    def transmittance(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the factor on the radiance of a grey object at the end of a camera ray.

        A camera sees the object's radiance times this, plus the veil. In the solved modes light that turns by a few
        degrees counts as passed: it blurs the object and does not dim it.

        Parameters
        ----------
        distance_m : array_like
            Lengths (...,) [m] of the rays.
        depth_m : array_like
            Depths (...,) [m] of the camera.
        up : array_like
            The y components (...,) of the view directions, -1 to 1.

        Returns
        -------
        ndarray
            Factor (..., 3) in (0, 1], weighted by the spectrum of the daylight at the object's depth. For grey objects
            it is exact if no response has a negative part; of the others `Bands.lobes` is used.

        Raises
        ------
        ParameterError
            If a distance or depth is negative, or `up` outside [-1, 1].

        See Also
        --------
        uw.medium.Medium.veil : The light that is added.
        uw.medium.Water.attenuation : The loss of a narrow beam.

        Examples
        --------
        >>> medium = uw.medium.Medium(uw.medium.Water.jerlov("IB"), mode="kd")
        >>> medium.transmittance([0.0, 10.0], 5.0, 0.0).round(3)
        array([[1.   , 1.   , 1.   ],
               [0.173, 0.344, 0.395]])
        """
        check_ray(distance_m, depth_m, up)
        s = ray_in_water(distance_m, depth_m, up)
        depth = np.maximum(np.asarray(depth_m, np.float64) - s * np.asarray(up, np.float64), 0.0)
        return np.exp(self.light.transmittance_log(s, np.minimum(depth, self.light.deepest_m), depth_m))

    def veil(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance that the water adds to a camera ray, times the gain.

        With the CIE observer clear water gives negative red: `compress_gamut` maps it, as the tables do.

        Parameters
        ----------
        distance_m : array_like
            Lengths (...,) [m] of the rays, which end at the surface.
        depth_m : array_like
            Depths (...,) [m] of the camera.
        up : array_like
            The y components (...,) of the view directions, -1 to 1.

        Returns
        -------
        ndarray
            Radiance (..., 3) [1/sr].

        Raises
        ------
        ParameterError
            If a distance or depth is negative, or `up` outside [-1, 1].

        See Also
        --------
        uw.medium.Medium.transmittance : What is left of the object's light.
        uw.medium.fit_gain : Finds the gain.
        uw.medium.compress_gamut : Brings negative colours into the gamut.

        Examples
        --------
        >>> medium = uw.medium.Medium(uw.medium.Water.jerlov("IB"), mode="kd")
        >>> medium.veil([0.0, 10.0], 5.0, 0.0).round(4)
        array([[0.    , 0.    , 0.    ],
               [0.0065, 0.0195, 0.0272]])
        """
        check_ray(distance_m, depth_m, up)
        veil = self.gain * self.bands.rgb(self.spectral_veil(distance_m, depth_m, up))
        return veil * self._lit(ray_in_water(distance_m, depth_m, up)) if self.shade else veil

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., 3) of water and sky along unobstructed rays, times the gain."""
        common_shape(depth_m=depth_m, up=up)
        return self.gain * self.bands.rgb(self.model.radiance(depth_m, up))

    def irradiance(self, depth_m: ArrayLike, normal_up: ArrayLike = 1.0) -> Array:
        """Return the irradiance of a surface, times the gain.

        Before the gain it is 1 for a level plane just below the surface; times albedo/pi it is the radiance of a
        diffuse surface. Closed forms have no directions: there all normals get the same.

        Parameters
        ----------
        depth_m : array_like
            Depths (...,) [m].
        normal_up : array_like
            The y components (...,) of the surface's normal: 1 looks up.

        Returns
        -------
        ndarray
            Irradiance (..., 3).

        Raises
        ------
        ParameterError
            If the shapes do not fit, or values are not finite.

        See Also
        --------
        uw.medium.LightField.irradiance : The same by wavelength.
        uw.datasets.of_medium : Results as labelled arrays.

        Examples
        --------
        >>> medium = uw.medium.Medium(uw.medium.Water.jerlov("IB"), mode="kd")
        >>> medium.irradiance([0.0, 10.0]).round(3)
        array([[1.   , 1.   , 1.   ],
               [0.163, 0.515, 0.67 ]])
        """
        common_shape(depth_m=depth_m, normal_up=normal_up)
        return self.gain * self.bands.rgb(self.model.irradiance(depth_m, normal_up))

    @checked
    def level_radiance(self, up: Array) -> Array:
        """Return the radiance (r, 3) at the camera from directions (r,), without gain, within the gamut.

        Cached, because every frame of a clip asks for the same directions.
        """
        key = "sky", up.tobytes()
        if key not in self._radiances:
            self._radiances[key] = self.light.display(self.model.radiance(self.camera_depth_m, up))
        return self._radiances[key]

    def _floor_light(self, up: Array) -> Array:
        """Return the radiance (r, 3) at the camera, by a floor of radiance 1, from directions (r,); cached too."""
        key = "floor", up.tobytes()
        if key not in self._radiances:
            self._radiances[key] = self.under("floor").model.radiance(self.camera_depth_m, up) @ self.floor_lobes
        return self._radiances[key]

    def scaled(self, gain: ArrayLike) -> Medium:
        """Return the same medium with veil and radiances multiplied by a gain, on top of its own.

        A model has no exposure: the gain of `fit_gain` brings it to that of a plate. Transmittance stays as it is. What
        is solved is shared, not solved again.

        Parameters
        ----------
        gain : array_like
            One number or (3,), at least 0.

        Returns
        -------
        Medium
            Another medium; this one stays as it is.

        Raises
        ------
        ParameterError
            If the gain has another shape, or is negative.

        See Also
        --------
        uw.medium.fit_gain : Finds the gain.
        uw.medium.Medium.veil : The radiance that it multiplies.

        Examples
        --------
        >>> medium = uw.medium.Medium(uw.medium.Water.jerlov("IB"), mode="kd")
        >>> medium.scaled(2.0).gain
        array([2., 2., 2.])
        """
        factor = np.broadcast_to(exactly("gain", gain, (), (3,)).astype(np.float64), (3,))
        if not np.all(np.isfinite(factor) & (factor >= 0.0)):
            raise ParameterError(f"gain - must be three numbers >= 0 (got {factor.tolist()}) - correct it")
        return self._changed(gain=self.gain * factor)

    def in_shade(self, shade: float) -> Medium:
        """Return the same medium with less veil before what is near, as under rock or in crushed blacks.

        shade: 0, none, to 1.
        The veil of a way s is 1 - shade exp(-4.8 s/V) of what it was, V the visibility (of the camera's layer): far
        away, where the contrast of bodies is lost, it is that of open water. Raises `ParameterError`.
        """
        if not 0.0 <= number("shade", shade) <= 1.0:
            raise ParameterError(f"shade - must be from 0 to 1 (got {shade!r}) - correct it")
        return self._changed(shade=float(shade))

    def along_sun(self, table: MediumTable, sun_up: float) -> MediumTable:
        """Return a table of this medium whose beam is that of a sun of that height: in layers it is another."""
        if not isinstance(self.model, LayeredModel):
            return table
        beam, unscattered = beam_tables(self.light, self.length_m, sun_up)
        return replace(table, beam=beam, unscattered=unscattered)

    def in_one_water(self) -> Medium:
        """Return the same medium in the water of the camera's layer alone; this one, where it has no layers."""
        water, solved = self.water, ("model", "light", "length_m", "unit_table", "glow_level", "floor_lobes")
        if not isinstance(water, LayeredWater):
            return self
        return self._changed(*solved, water=water.layers[water.here], _radiances={})

    def for_drafts(self) -> Medium:
        """Return the same medium, whose tables and light about the sun are computed roughly, see `around_sun`."""
        return self._changed("unit_table", rough=True)

    def _lit(self, way_m: Array) -> Array:
        return 1.0 - self.shade * np.exp(-CONTRAST_LENGTHS / visibility_m(self.water) * way_m)[..., None]

    def lit_by_floor(self, radiance: ArrayLike) -> Medium:
        """Return the same medium over a floor of a radiance (3,); level light stays what it is."""
        light = exactly("radiance", radiance, (), (3,)).astype(np.float64)
        return self._changed(floor_radiance=np.broadcast_to(light, (3,)))

    def under(self, sky: Sky) -> Medium:
        """Return the same water under another sky, without gain."""
        if sky == self.sky or self.mode in CLOSED_FORMS or self.mode in _FORMATIONS:
            return self
        of_this_sky = "model", "light", "unit_table", "glow_level", "floor_lobes"
        return self._changed(*of_this_sky, sky=sky, gain=np.ones(3), floor_radiance=np.zeros(3), _radiances={})

    @checked
    def at_depth(
        self, camera_depth_m: float, unit_table: MediumTable | None = None, between_m: tuple[float, ...] = ()
    ) -> Medium:
        """Return the same medium for a camera at another depth; its tables keep the length of this one's.

        unit_table: a `unit_table` for that depth which is known already. between_m: two depths [m] of the camera that
        its light may be interpolated between, for a camera that rises or sinks.
        """
        known = {} if unit_table is None else {"unit_table": unit_table}
        return self._changed(
            "unit_table", "glow_level", camera_depth_m=float(camera_depth_m), between_m=between_m,
            length_m=self.length_m, _radiances={}, **known,
        )  # fmt: skip

    def _changed(self, *solved: str, **values: Any) -> Medium:
        """Return a copy with other values, without its table and other cached properties that do not hold for it."""
        other = copy.copy(self)
        for name in ("table", *solved):
            vars(other).pop(name, None)
        vars(other).update(values)
        return other

    # --- for the tables ----------------------------------------------------------------------------------------

    @checked
    def unit_veil(self, distance_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the veil (..., 3) of rays from the camera, which must end below the surface, without gain.

        Colours are within the gamut.
        """
        return self.light.display(self.model.inscatter(distance_m, self.camera_depth_m, up))

    @functools.cached_property
    def floor_lobes(self) -> Array:
        """Weights (n, 3) of the bands for light from the floor: `Bands.lobes` in the daylight that comes down to it."""
        assert self.floor_m is not None
        lit = self.bands.lobes * self.model.irradiance(self.floor_m, 1.0)[:, None]
        return np.asarray(lit / np.maximum(lit.sum(axis=0), _TINY))

    def _glow(self, distance_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the veil (..., 3) by a floor of radiance 1."""
        return self.under("floor").model.inscatter(distance_m, self.camera_depth_m, up) @ self.floor_lobes

    def far_light(self, up: Array, gain: Floats, floor: Floats) -> tuple[Array, Array]:
        """Return the light (r, 3) of open water at the camera from directions (r,) over its floor, for a gain of 1,
        and the share (r, 3) of it that comes from the floor.

        gain: (3,) of the plate's veil. floor: (3,) radiance of the floor in the light of the plate.
        """
        level = self.level_radiance(up)
        if self.floor_m is None:
            return level, np.zeros(level.shape)
        floor = floor / np.maximum(gain, _TINY)
        glow = floor * self._floor_light(up)
        light = level + glow - floor * level * self.glow_level
        return light, np.clip(glow / np.maximum(light, _TINY), 0.0, 1.0)

    def far_veil(self, up: Array, gain: Floats, floor: Floats) -> Array:
        """Return the veil (r, 3) of ways longer than one sees, in directions (r,) below the horizon, for a gain of 1.

        It is the light of open water where the floor falls away. gain, floor: see `far_light`.
        """
        far = np.full(len(up), _FAR_LENGTHS * self.length_m)
        veil = self.unit_veil(far, up)
        if self.floor_m is None:
            return veil
        return veil + floor / np.maximum(gain, _TINY) * (self._glow(far, up) - veil * self.glow_level)

    def floor_seen(self, gain: Floats, upwelling: Floats) -> Array:
        """Return the radiance (3,) of the floor in the light of a plate, 0 without a floor.

        gain: (3,) of the plate's veil. upwelling: (3,) its light on a level plane at the camera that faces down.
        """
        if self.floor_m is None:
            return np.zeros(3)
        of_sky = self.model.irradiance(self.camera_depth_m, -1.0) @ self.bands.lobes
        of_floor = self.floor_irradiance(self.camera_depth_m, -1.0) - self.glow_level * of_sky
        return np.asarray(
            np.clip((upwelling - gain * of_sky) / np.maximum(of_floor, _TINY), 0.0, gain * self._most_glow)
        )

    @checked
    def floor_irradiance(self, depth_m: float, normal_up: float = 1.0) -> Array:
        """Return the irradiance (3,) by a floor of radiance 1, on planes whose normal has the y `normal_up`."""
        return np.asarray(self.under("floor").model.irradiance(depth_m, normal_up) @ self.floor_lobes)

    @functools.cached_property
    def glow_level(self) -> Array:
        """Level light (3,) of a floor of radiance 1 over that of the sky."""
        return np.asarray(self._floor_light(np.zeros(1))[0] / np.maximum(self.level_radiance(np.zeros(1))[0], _TINY))

    @property
    def _most_glow(self) -> Array:
        """Radiance (3,) of a floor that would be all of the level light for a gain of 1."""
        return 1.0 / np.maximum(self.glow_level, _TINY)


# Medium tables for a camera whose depth changes, and for water that changes.
#
# Tables are made at fixed depths, each 6 % deeper than the one before, and interpolated between them: linearly, the
# veil in its logarithm. A frame's table depends on its depth alone and changes continuously from frame to frame.

TableAt = Callable[[float], MediumTable]

_RATIO = 1.06
"""Ratio of neighbouring depths. The interpolation error is at most 0.3 %; twice the step gives four times that."""
_KEPT = 16
"""Tables kept, enough for a swim over a factor of 2.4 in depth without making one twice."""


class MediumAtDepths:
    """The media of one water, sensor and mode at any depth of the camera."""

    def __init__(self, medium: Medium) -> None:
        self._medium = medium
        self._node = functools.lru_cache(maxsize=_KEPT)(self._made)

    def at(self, depth_m: float) -> Medium:
        """Return the medium for a camera at a depth [m], > 0."""
        place = float(np.log(depth_m) / np.log(_RATIO))
        step = int(np.floor(place))
        upper, lower = self._node(step), self._node(step + 1)
        above_m, below_m = upper.camera_depth_m, lower.camera_depth_m
        share = (depth_m - above_m) / (below_m - above_m) if below_m > above_m else 0.0
        table = replace(_mixed_table(upper, lower, share), camera_depth_m=depth_m)
        return self._medium.at_depth(depth_m, table, (above_m, below_m) if below_m > above_m else ())

    def _made(self, step: int) -> MediumTable:
        floor_m = self._medium.floor_m  # below which there is no water
        depth_m = _RATIO**step
        return self._medium.at_depth(depth_m if floor_m is None else min(depth_m, floor_m)).unit_table


class MixedMedium:
    """Medium at any depth of a water between two others, a fraction `share` of the way.

    exact: of the water itself. first, second: tables, by depth, of the two. To tabulate a solved light field takes a
    third of a second, all else of a medium a hundredth.
    """

    def __init__(self, exact: Medium, first: TableAt, second: TableAt, share: float) -> None:
        self._exact, self._first, self._second, self._share = exact, first, second, share

    def at(self, depth_m: float) -> Medium:
        """Return the medium for a camera at a depth [m], > 0."""
        exact, mixed = self._exact, _mixed_table(self._first(depth_m), self._second(depth_m), self._share)
        table = replace(mixed, camera_depth_m=depth_m, length_m=exact.length_m, refractive_index=exact.refractive_index)
        return exact.at_depth(depth_m, table)


def _mixed_table(first: MediumTable, second: MediumTable, share: float) -> MediumTable:
    """Return the first of two tables, its values mixed with those of the second, of which `share` is taken."""
    floats = {
        name: ((1.0 - share) * getattr(first, name) + share * getattr(second, name)).astype(np.float32)
        for name in ("attenuation", "diffuse", "beam", "unscattered")
    }
    if first.glow is not None and second.glow is not None:
        floats["glow"] = (1.0 - share) * first.glow + share * second.glow
    # light falls off as an exponential of depth and of coefficients: the veil's logarithm is mixed
    floats["veil"] = first.veil ** (1.0 - share) * second.veil**share
    return replace(first, **floats)
