# SPDX-License-Identifier: Apache-2.0
"""Spectral models of light in water: attenuation, in-scatter, radiance and irradiance at n wavelengths.

KdModel: one exponential, the published closed form. FieldModel: the solved light field; LayeredModel: that of water in
layers, as a scene's profile has it (LayeredWater). All return (..., n), per unit downwelling irradiance just below the
surface. FormationModel has one constant per channel instead of a spectrum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.cache import shared
from mr360uw.base.constants import INV_4PI, REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import critical_cosine
from mr360uw.base.parameters import checked
from mr360uw.medium.closed_form import path_integral, ray_in_water, together
from mr360uw.medium.layers import LayeredField, LayeredRays, layer_means, read_profile
from mr360uw.medium.phase import Mixture, Phase
from mr360uw.medium.ray_field import LambertFloor, Sky, SurfaceKind, length_to
from mr360uw.medium.transfer import STREAMS_PER_HEMISPHERE, LightField
from mr360uw.medium.water import Water, molecular_part
from mr360uw.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class UndirectedModel:
    """Light of one kind, which has no direction: what closed forms and fitted formations have in common.

    extinction: (n,) [1/m] of objects and beams; nothing that has been scattered is in it. diffuse: (n,) [1/m] by which
    the irradiance falls off with depth.
    """

    extinction: Array
    diffuse: Array

    @property
    def attenuation(self) -> Array:
        """The extinction: all scattered light is lost to the image."""
        return self.extinction

    @property
    def level_beam(self) -> float:
        """All light at the surface."""
        return 1.0

    def irradiance(self, depth_m: ArrayLike, normal_up: ArrayLike) -> Array:
        """Return exp(-diffuse y) for every normal."""
        y = together(depth_m, normal_up)[0]
        return np.exp(-self.diffuse * y[..., None])


@dataclass(frozen=True, slots=True, eq=False)
class KdModel(UndirectedModel):
    """Isotropic scattering of an irradiance that falls off as exp(-Kd y).

    scattered: (n,) [1/m] b as published (Monzon et al. 2022); for `kd+` times Gershun's factor, see `gershun_factor`.
    """

    scattered: Array

    def inscatter(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the closed form (..., n); not cut at the surface, so that tables can reach past it."""
        s, y, mu = (np.asarray(x, np.float64)[..., None] for x in (distance_m, depth_m, up))
        return self.scattered * INV_4PI * path_integral(self.extinction, self.diffuse, s, y, mu)

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the in-scattered light of the whole ray: the model has no sky."""
        return self.inscatter(ray_in_water(np.inf, depth_m, up), depth_m, up)


@dataclass(frozen=True, slots=True, eq=False)
class FormationModel(UndirectedModel):
    """The image formation model I = J exp(-beta_D z) + B (1 - exp(-beta_B z)), one constant per channel.

    extinction: beta_D, backscatter: beta_B [1/m], veil: B, all (3,). Koschmieder 1924 has beta_D = beta_B; Akkaynak &
    Treibitz 2018 eq. 20 keep them apart.
    """

    backscatter: Array
    veil: Array

    def inscatter(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return B (1 - exp(-beta_B z)), the same in every direction and at every depth."""
        s = together(distance_m, depth_m, up)[0][..., None]
        return -self.veil * np.expm1(-self.backscatter * s)

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return B."""
        shape = np.broadcast_shapes(np.shape(depth_m), np.shape(up))
        return np.broadcast_to(self.veil, (*shape, 3))


def gershun_factor(a: ArrayLike, b: ArrayLike, kd: ArrayLike, g: ArrayLike) -> Array:
    """Return scalar irradiance over downwelling irradiance deep down, Kd (1 - R)/a (Gershun's law).

    R = (1 - s)(1 - 0.139 s)/(1 + 1.17 s), s = sqrt(1 - w), w = b(1 - g)/(a + b(1 - g)): reflectance of a deep medium
    after similarity scaling (van de Hulst 1980 ch. 14).
    """
    a, b, kd, g = (np.asarray(x, np.float64) for x in (a, b, kd, g))
    s = np.sqrt(1.0 - b * (1.0 - g) / (a + b * (1.0 - g)))
    reflectance = (1.0 - s) * (1.0 - 0.139 * s) / (1.0 + 1.17 * s)
    return kd * (1.0 - reflectance) / a


class FieldModel:
    """The solved light field, with light scattered by small angles counted as part of the image.

    Objects are dimmed by absorption and wide-angle scattering only. The in-scatter is the rest of the ray's radiance:
    radiance(camera) = inscatter + exp(-extinction S) radiance(end). Inside Snell's window that difference would
    subtract the bright window behind the object; there the in-scatter is that of wide angles alone (`wide`). The two
    are blended over the last degrees below the window's edge. part: the scattering by wide angles. inputs: all that
    decides it.
    """

    def __init__(self, field: LightField, part: Mixture, inputs: tuple[object, ...] = ()) -> None:
        self.field, self.part, self.inputs = field, part, inputs
        self.wide = field.scattered_by(part)

    def up_to_order(self, most: int) -> FieldModel:
        """Return the same with fewer orders of light about the sun, see `LightField.up_to_order`."""
        return FieldModel(self.field.up_to_order(most), self.part)

    def around_sun(self, depth_m: ArrayLike, up: Array, azimuth_rad: Array) -> Array:
        """Return `inscatter` (..., r, a, n) at depths (...,) of endless rays in directions of y (r,), at azimuths (a,)
        from the sun's.
        """
        depth, mu = together(np.asarray(depth_m)[..., None], up)

        def gained(part: LightField) -> Array:
            seen = FieldModel(part, self.part)
            return seen._mixed(seen._complement, seen.wide.inscatter, ray_in_water(np.inf, depth, mu), depth, mu)

        whole = gained(self.field.beam_at(azimuth_rad)).reshape(*mu.shape, len(azimuth_rad), -1)
        for order in self.field.azimuth_orders:
            whole += np.cos(order * azimuth_rad)[:, None] * gained(self.field.at_azimuth(0.0, order))[..., None, :]
        return np.maximum(whole, 0.0)

    @property
    def extinction(self) -> Array:
        """Attenuation by absorption and scattering by wide angles."""
        return self.wide.extinction

    @property
    def attenuation(self) -> Array:
        """Attenuation by absorption and all scattering."""
        return self.field.absorption + self.field.scattering

    @property
    def level_beam(self) -> Array:
        """That of the field."""
        return self.field.level_beam

    def inscatter(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the light (..., n) that rays gain on the way to the camera."""
        s, y, mu = together(ray_in_water(distance_m, depth_m, up), depth_m, up)
        # towards a sun without Snell's window its glow is brighter at the ray's end
        return np.maximum(self._mixed(self._complement, self.wide.inscatter, s, y, mu), 0.0)

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., n) of water and sky along the same rays."""
        y, mu = together(depth_m, up)
        return self._mixed(self.field.radiance, self.wide.radiance, y, mu)

    def irradiance(self, depth_m: ArrayLike, normal_up: ArrayLike) -> Array:
        """Return the field's irradiance (..., n)."""
        return self.field.irradiance(depth_m, normal_up)

    def _complement(self, s: Array, y: Array, mu: Array) -> Array:
        """Return the radiance that rays gain in the solved field when they decay with the extinction of `wide`."""
        own, slower = self.field.rays, self.extinction
        to_floor = own.to_floor(y, mu)
        above, end_m = np.minimum(s, to_floor), np.maximum(y - s * mu, 0.0)
        end_m = np.where(s >= to_floor, own.floor_m, np.where(end_m < _AT_SURFACE * y, 0.0, end_m))
        end = own.radiance(end_m, mu)
        lost, gap = np.exp(-slower * above[:, None]), own.extinction - slower
        # exp(-slower S) - exp(-own S), by the larger of the two: backward scattering makes `wide` the faster one
        larger = np.exp(-np.minimum(slower, own.extinction) * above[:, None])
        apart = larger * np.sign(gap) * -np.expm1(-np.abs(gap) * above[:, None])
        result = own.inscatter(above, y, mu) - apart * end
        below = s > above
        if np.any(below):  # goes on as it is at the floor, see `RayField.inscatter`
            mu, deeper = mu[below], (s - above)[below][:, None]
            gained = own.scattered(own.floor_m, mu) - gap * own.floor
            result[below] += lost[below] * gained * -np.expm1(-slower * deeper) / slower
        return result

    def _mixed(self, whole: Callable[..., Array], wide: Callable[..., Array], *ray: Array) -> Array:
        """Return `whole` below Snell's window and `wide` inside it, blended; `ray` ends in the view direction's y."""
        share = window_share(ray[-1], self.field.refractive_index)
        result = np.zeros((*share.shape, len(self.extinction)))
        for part, weight in ((whole, 1.0 - share), (wide, share)):
            used = weight > 0.0
            if np.any(used):
                result[used] += weight[used][:, None] * part(*(a[used] for a in ray))
        return result


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LayeredWater(Water):
    """Water in layers; all that a `Water` has is that of the layer that a camera is in.

    top_m: (L,) depths [m] at which layers begin, the first 0. layers: (L,). here: number of the camera's.
    """

    top_m: tuple[float, ...] = (0.0,)
    layers: tuple[Water, ...] = ()
    here: int = 0


def layered_water(path: Path, like: Water, camera_depth_m: float) -> LayeredWater:
    """Return the water of a CSV file's profile, in the layers of `LayeredField.from_csv`, equal ones joined.

    like: gives the phase function of the particles, and whether molecules are told apart from them. Raises
    `ParameterError`.
    """
    depth, nm, a, b = read_profile(path)
    top, a, b = layer_means(depth, a, b, where=f"{path}, ")
    new = np.append(True, np.any(np.abs(np.diff([a, b], axis=1)) > _EQUAL, axis=(0, 2)))
    here = int(np.searchsorted(top[new], camera_depth_m, side="right")) - 1
    table = tuple(values.tobytes() for values in (top[new], nm, a[new], b[new]))
    return _layered(str(path), table, like.phase, like.molecular is not None, here)


_EQUAL = 1e-9
"""Difference of coefficients [1/m] up to which layers are one: the rounding of means."""


@shared(keep=16)
def _layered(path: str, table: tuple[bytes, ...], phase: Phase, molecules: bool, here: int) -> LayeredWater:
    top, nm, a, b = (np.frombuffer(values) for values in table)
    layers = []
    for depth, absorption, scattering in zip(top, a.reshape(len(top), -1), b.reshape(len(top), -1), strict=True):
        layer = Water.from_arrays(nm, absorption, scattering, None, phase, f"{Path(path).name} from {depth:g} m")
        layers.append(replace(layer, molecular=molecular_part(layer.b) if molecules else None, source=path))
    own, tops = layers[here], tuple(top.tolist())
    return LayeredWater(own.name, own.a, own.b, None, phase, own.molecular, path, tops, tuple(layers), here)


# Layers. Each has its own extinction e_l by absorption and by wide angles. Over a path of length S between the depths y
# and y' the optical length is that of the depths in between, by the path's slope:
#
#     tau = S/(y' - y) int_y^y' e dy = S mean(e)        level: e of its layer
#
# The in-scatter is again what the radiance at the camera has beside that of the path's end,
#
#     L(y, mu) - exp(-tau) L(y', mu)
#
# of the solved field below Snell's window, and inside it of the field in which only wide angles scatter into the ray. A
# difference of doubles is exact enough: the tables' shortest path is 1e-4 of their length, where 1e-12 of it is lost.


class LayeredModel(FieldModel):
    """The same of water in layers. parts: of each, the scattering by wide angles. here: number of the camera's layer.

    `extinction` and `attenuation`, which know no depth, are those of the camera's layer. Light is the mean over the
    azimuth from the sun's.
    """

    field: LayeredField  # type: ignore[assignment]
    wide: LayeredRays  # type: ignore[assignment]

    def __init__(self, field: LayeredField, parts: list[Mixture], here: int, inputs: tuple[object, ...]) -> None:
        self.field, self.wide, self.inputs, self._here = field, field.scattered_by(parts), inputs, here

    @property
    def extinction(self) -> Array:
        """Attenuation by absorption and scattering by wide angles in the camera's layer."""
        return np.asarray(self.wide.extinction[self._here])

    @property
    def attenuation(self) -> Array:
        """Attenuation by absorption and all scattering in the camera's layer."""
        return np.asarray((self.field.absorption + self.field.scattering)[self._here])

    def _complement(self, s: Array, y: Array, mu: Array) -> Array:
        """Return the radiance that rays gain, see above; below the floor water goes on as it is there."""
        own = self.field.rays
        above, end_m = np.minimum(s, length_to(own.floor_m, y, mu)), np.maximum(y - s * mu, 0.0)
        end_m = np.where(end_m < _AT_SURFACE * y, 0.0, end_m)  # below the floor it has the floor's light
        lost = np.exp(-self.wide.optical_length(above, y, mu))
        result = np.asarray(own.radiance(y, mu) - lost * own.radiance(end_m, mu))
        below = s > above
        if np.any(below):  # as `FieldModel._complement`
            last, slower, deeper = own.layers[-1], self.wide.extinction[-1], (s - above)[below][:, None]
            gained = last.scattered(own.floor_m, mu[below]) - (last.extinction - slower) * own.floor
            result[below] += lost[below] * gained * -np.expm1(-slower * deeper) / slower
        return result


SpectralModel = KdModel | FormationModel | FieldModel
"""Radiance and irradiance in water at n wavelengths. A model is a key of caches by its identity."""


def mean_rates(model: SpectralModel, from_m: ArrayLike, to_m: ArrayLike) -> tuple[Array, Array]:
    """Return the mean extinction and attenuation [1/m] of paths between two depths (...): (..., n), or (n,) for all."""
    if not isinstance(model, LayeredModel):
        return model.extinction, model.attenuation
    field, both = model.field, (model.wide.extinction, model.field.absorption + model.field.scattering)
    return field.mean(both[0], from_m, to_m), field.mean(both[1], from_m, to_m)


def window_share(up: Array, refractive_index: float) -> Array:
    """Return 1 for directions of a y inside Snell's window, 0 outside, blended below its edge; 0 without a window."""
    edge = critical_cosine(refractive_index)
    x = np.clip((up - edge) / _WINDOW_BLEND + 1.0, 0.0, 1.0) if edge > 0.0 else np.zeros(np.shape(up))
    return np.asarray(x * x * (3.0 - 2.0 * x))


_AT_SURFACE = 1e-9
"""Depth of a ray's end, over the camera's, below which it lies at the surface: what rounding leaves of 0."""
_WINDOW_BLEND = 0.06
"""Width of the blend below the edge of Snell's window, in the y of the direction (4 degrees).

Twice as wide, more of the water outside the window lacks the light of small angles.
"""
SpectralMode = Literal["kd", "kd+", "table"]
CLOSED_FORMS = ("kd", "kd+", "rgb")
"""Modes of a medium whose veil is a closed form: they scatter isotropically and count all scattered light as lost.
Their tables take two hundredths of a second."""


@checked
def spectral_model(
    water: Water,
    wavelength_nm: ArrayLike,
    mode: SpectralMode,
    surface: SurfaceKind = "snell",
    sky: Sky = "uniform",
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    floor: LambertFloor | None = None,
) -> SpectralModel:
    """Return the model of a water at wavelengths (n,) [nm]; a field that has been solved before is found again.

    surface, sky, refractive_index, floor: of mode "table", see `LightField`; the closed forms have none of them, and of
    a `LayeredWater` the camera's layer alone.
    """
    w = np.atleast_1d(np.asarray(wavelength_nm, np.float64))
    if mode == "table":
        return _field_model(water, tuple(w.tolist()), surface, sky, refractive_index, floor)
    a, b, kd = water.absorption(w), water.scattering(w), water.diffuse_attenuation(w)
    factor = gershun_factor(a, b, kd, water.moments(w, 2)[:, 1]) if mode == "kd+" else np.ones(len(w))
    return KdModel(a + b, kd, factor * b)


@shared(keep=48)
def _field_model(
    water: Water,
    wavelength_nm: tuple[float, ...],
    surface: SurfaceKind,
    sky: Sky,
    refractive_index: float,
    floor: LambertFloor | None,
) -> FieldModel:
    w = np.array(wavelength_nm)
    if isinstance(water, LayeredWater):
        return _layered_model(water, w, surface, sky, refractive_index, floor)
    whole, wide = water.phases(w), water.phases(w, wide_angle=True)
    a, b = water.absorption(w), water.scattering(w)
    field = LightField(a, b, whole, surface, sky, refractive_index, floor=floor)
    of_phase = whole.particles, whole.molecular, whole.moments(2 * STREAMS_PER_HEMISPHERE)
    return FieldModel(field, wide, (a, b, *of_phase, surface, sky, refractive_index, floor, w))


def _layered_model(
    water: LayeredWater, w: Array, surface: SurfaceKind, sky: Sky, refractive_index: float, floor: LambertFloor | None
) -> LayeredModel:
    """Return the model of the layers above a floor."""
    layers = [water.layers[k] for k, top in enumerate(water.top_m) if floor is None or top < floor.depth_m]
    tops, here, orders = water.top_m[: len(layers)], min(water.here, len(layers) - 1), 2 * STREAMS_PER_HEMISPHERE
    a, b = np.array([layer.absorption(w) for layer in layers]), np.array([layer.scattering(w) for layer in layers])
    whole, wide = ([layer.phases(w, wide_angle=wide) for layer in layers] for wide in (False, True))
    of_phase = [x for phase in whole for x in (phase.particles, phase.molecular, phase.moments(orders))]
    field = LayeredField(tops, a, b, whole, surface, sky, refractive_index, floor=floor)
    return LayeredModel(field, wide, here, (tops, here, a, b, *of_phase, surface, sky, refractive_index, floor, w))
