# SPDX-License-Identifier: Apache-2.0
"""Medium lookup: veil, transmittance, daylight and sun's beam from a `MediumTable`, and how a medium is tabulated.

A pixel costs the same for any number of wavelengths in the table. Twin: lookup.glsl.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.color import luminance
from mr360uw.base.constants import BRIGHTEST_LOG, GAMUT_POWER, GAMUT_THRESHOLD
from mr360uw.base.disk_cache import kept_arrays
from mr360uw.base.parameters import vectors
from mr360uw.base.texels import between_four
from mr360uw.medium.models import FieldModel, FormationModel, LayeredModel, SpectralModel, mean_rates
from mr360uw.medium.wavelengths import Bands
from mr360uw.types import Array, Floats, MediumTable


def table_coordinate(length: ArrayLike, length_m: float) -> Floats:
    """Return S/(S + length_m) in [0, 1] for lengths S >= 0; 1 at infinity."""
    s = np.maximum(np.asarray(length, np.float64), 0.0)
    return 1.0 - length_m / (s + length_m)


def bilinear(table: Floats, u: ArrayLike, v: ArrayLike) -> Floats:
    """Return values (..., 3) of a table (U, V, 3) at coordinates in [0, 1], nodes at the ends."""
    rows, columns = table.shape[:2]
    u, v = np.broadcast_arrays(np.asarray(u, np.float64), np.asarray(v, np.float64))
    x, y = np.clip(u, 0.0, 1.0) * (rows - 1), np.clip(v, 0.0, 1.0) * (columns - 1)
    i, j = np.minimum(x.astype(np.int64), rows - 2), np.minimum(y.astype(np.int64), columns - 2)
    fx, fy = (x - i)[..., None], (y - j)[..., None]
    return np.asarray(between_four(table[i, j], table[i, j + 1], table[i + 1, j], table[i + 1, j + 1], fy, fx))


def linear(table: Floats, u: ArrayLike) -> Floats:
    """Return values (..., 3) of a table (U, 3) at coordinates in [0, 1], nodes at the ends."""
    x = np.clip(np.asarray(u, np.float64), 0.0, 1.0) * (len(table) - 1)
    i = np.minimum(x.astype(np.int64), len(table) - 2)
    f = (x - i)[..., None]
    return table[i] * (1.0 - f) + table[i + 1] * f


def in_water_distance(distance_m: ArrayLike, camera_depth_m: float, up: ArrayLike) -> Floats:
    """Return the length (...,) [m] of a camera ray that lies below the mean surface."""
    s, mu = np.broadcast_arrays(np.asarray(distance_m, np.float64), np.asarray(up, np.float64))
    return np.minimum(s, camera_depth_m / np.maximum(mu, 1e-9))


def veil_lookup(table: MediumTable, distance_m: ArrayLike, up: ArrayLike) -> Floats:
    """Return the radiance (..., 3) the water adds to a camera ray of length `distance_m`; `up` = y of its direction."""
    s = in_water_distance(distance_m, table.camera_depth_m, up)
    smooth = bilinear(table.veil, 0.5 + 0.5 * np.asarray(up, np.float64), table_coordinate(s, table.length_m))
    return -np.expm1(-s / table.length_m)[..., None] * smooth


def transmittance_lookup(table: MediumTable, distance_m: ArrayLike, up: ArrayLike) -> Floats:
    """Return the factor (..., 3) on the radiance of an object `distance_m` along a camera ray."""
    return np.exp(-optical_length(table, distance_m, up))


def optical_length(table: MediumTable, distance_m: ArrayLike, up: ArrayLike) -> Floats:
    """Return the negative logarithm (..., 3) of `transmittance_lookup`."""
    s = in_water_distance(distance_m, table.camera_depth_m, up)
    depth = table.camera_depth_m - np.where(np.isfinite(s), s, 0.0) * np.asarray(up, np.float64)
    attenuation = bilinear(
        table.attenuation, table_coordinate(depth, table.length_m), table_coordinate(s, table.length_m)
    )
    return attenuation * s[..., None]


def ambient_ratio(table: MediumTable, depth_m: ArrayLike, normal_up: ArrayLike = 1.0) -> Floats:
    """Return the ambient irradiance (..., 3) at a depth over that at the camera, on normals whose y is `normal_up`."""
    d = np.maximum(np.asarray(depth_m, np.float64), 0.0)
    normal = 0.5 + 0.5 * np.asarray(normal_up, np.float64)
    diffuse = bilinear(table.diffuse, normal, table_coordinate(d, table.length_m))
    return np.exp(np.minimum(-diffuse * (d - table.camera_depth_m)[..., None], BRIGHTEST_LOG))


def beam_ratio(table: MediumTable, depth_m: ArrayLike, sun_up: float) -> Floats:
    """Return the sun's beam (..., 3) at a depth over that at the camera; `sun_up` = y of its direction."""
    here = path_attenuation(table, table.beam, table.camera_depth_m, sun_up)
    return np.exp(np.minimum(here - path_attenuation(table, table.beam, depth_m, sun_up), BRIGHTEST_LOG))


def beam_fraction(table: MediumTable, depth_m: ArrayLike, sun_up: float) -> Floats:
    """Return the fraction (..., 3) of the sun's beam just below the surface that is left at a depth."""
    return np.exp(-path_attenuation(table, table.beam, depth_m, sun_up))


def path_attenuation(table: MediumTable, per_metre: Floats, depth_m: ArrayLike, sun_up: float) -> Floats:
    """Return the optical length (..., 3) of the beam's path from the surface to a depth.

    per_metre: the table's `beam` or `unscattered`.
    """
    path = np.maximum(np.asarray(depth_m, np.float64), 0.0) / sun_up
    return linear(per_metre, table_coordinate(path, table.length_m)) * path[..., None]


def unscattered_share(table: MediumTable, depth_m: ArrayLike, sun_up: float) -> Floats:
    """Return the fraction s (..., 3) of the beam at a depth that is unscattered and so carries the caustic pattern.

    The beam of `beam_ratio` decays with c' = a + b (1 - f) [1/m]: the fraction f of the scattering is by small angles
    and leaves light in it. The caustic pattern C is carried by light that has not been scattered, which decays with
    c = a + b. After the path p = d/sun_up [m] the irradiance under waves is beam (1 + (C - 1) s), s = exp(-(c - c') p).
    Relative to all downwelling light, exp(-Kd d), the pattern has the contrast exp(-(c/sun_up - Kd) d). Light that has
    turned by small angles has a blurred pattern besides: see `scattered_light`.
    """
    lost = path_attenuation(table, table.unscattered, depth_m, sun_up)
    return np.exp(np.minimum(path_attenuation(table, table.beam, depth_m, sun_up) - lost, 0.0))


# `BandModel` is the light of a spectral model in the linear RGB of a sensor. Ratios of light (transmittance, daylight
# over depth, the sun's beam) are computed as logarithms of sums over wavelength with the non-negative weights
# `Bands.lobes`, so that they stay finite and positive however dark the water is.
#
# Light in clear water is more saturated than any mixture of Rec.709 primaries: its red is negative. `compress_gamut`
# maps such colours into the gamut smoothly. Each channel's distance from the largest, d = 1 - x/max, is compressed
# above a threshold towards 1, by the curve of the reference gamut compression of ACES 1.3 (AMPAS 2021) with its limit
# at infinity; then the luminance is restored. Colours well inside are unchanged; k times a colour gives k times the
# result.

UnitVeil = Callable[[Array, Array], Array]

VEIL_SIZE, CLOSED_VEIL_SIZE = (129, 24), (129, 40)
ATTENUATION_SIZE = (64, 96)
DEPTH_SIZE = 256
NORMALS = 17
"""Nodes over (up, distance), of closed forms too, whose veil bends more, (depth, distance), depth and (y of a normal,
depth).

Chosen so that the mean error against direct sums over wavelength is below 0.1 % and that of 95 % of rays below 0.5 %.
"""
LAYERED_VEIL_SIZE, LAYERED_DEPTHS = (257, 80), 512
"""Nodes of veil, and depths of attenuation, of water in layers, whose light bends where paths meet another layer."""
_COARSER, _FEWER_DEPTHS = 2, 128
"""Of drafts: nodes over the directions of veil and normals for one of theirs, beside two thirds of the distances, and
depths of ambient light: half the time, 0.1 to 0.3 % in the mean, 95 % of rays below 1 %."""

HIGH_SUN_UP = 0.85
"""Sine of the elevation in the water of a high sun, where none is known."""
_TINY = 1e-300
_FARTHEST = 1e4
"""The last node stands for infinity and is evaluated at this many table lengths."""
STEP = 1e-4
"""Relative step of one-sided derivatives, and least distance at which quotients are evaluated, in table lengths."""


def lengths(count: int, length_m: float) -> Array:
    """Return the distances (count,) whose table coordinates are uniform; the last is large, not infinite."""
    t = np.arange(count) / (count - 1)
    return length_m * np.append(t[:-1] / (1.0 - t[:-1]), _FARTHEST)


def depth_nodes(length_m: float, deepest_m: float, *, rough: bool) -> Array:
    """Return the depths [m] (D,) of the tables of ambient light, at most `deepest_m`. rough: of drafts."""
    return np.minimum(lengths(_FEWER_DEPTHS if rough else DEPTH_SIZE, length_m), deepest_m)


def normal_nodes(*, rough: bool) -> Array:
    """Return the y (N,) of the normals of tables over them. rough: of drafts."""
    return np.linspace(-1.0, 1.0, NORMALS // _COARSER + 1 if rough else NORMALS)


def medium_table(
    light: BandModel,
    camera_depth_m: float,
    length_m: float,
    unit_veil: UnitVeil,
    mode: str,
    glow: UnitVeil | None = None,
    *,
    rough: bool = False,
) -> MediumTable:
    """Return the tables of a camera at a depth, colours within the gamut; those of a solved field are kept on the disk.

    length_m: L of the coordinates S/(S + L). unit_veil: function of (distance, up) that gives the veil (..., 3) of
    camera rays, without gain, of a mode of `Medium`. glow: the same of a floor of radiance 1, or None. rough: with
    fewer nodes, for drafts. The veil stays in double precision: at 200 m it is 1e-90 of the surface's light, and only
    the gain brings it back.
    """
    inputs = light.model.inputs if isinstance(light.model, FieldModel) else ()
    size = VEIL_SIZE if inputs else CLOSED_VEIL_SIZE
    size = LAYERED_VEIL_SIZE if isinstance(light.model, LayeredModel) else size
    size = (size[0] // _COARSER + 1, 2 * size[1] // 3) if rough else size

    def tables() -> dict[str, Array]:
        return {
            "veil": _veil(unit_veil, camera_depth_m, length_m, size),
            **({} if glow is None else {"glow": _veil(glow, camera_depth_m, length_m, size)}),
            "attenuation": _attenuation(light, camera_depth_m, length_m).astype(np.float32),
            "diffuse": _diffuse(light, camera_depth_m, length_m, rough=rough).astype(np.float32),
            **dict(zip(("beam", "unscattered"), beam_tables(light, length_m), strict=True)),
        }

    of_bands = light.bands.wavelength_nm, light.bands.weight
    depends_on = mode, camera_depth_m, length_m, size, rough, *of_bands, *inputs
    return MediumTable(camera_depth_m, length_m, **(kept_arrays("water", depends_on, tables) if inputs else tables()))


def _veil(unit_veil: UnitVeil, camera_depth_m: float, length_m: float, size: tuple[int, ...]) -> Array:
    up_step = 2.0 / (size[0] - 1)
    up = np.linspace(-1.0, 1.0, size[0])[:, None]
    s = np.broadcast_to(lengths(size[1], length_m), size)
    out = camera_depth_m / np.maximum(up, 1e-9)
    inside = np.clip(s, STEP * length_m, np.where(up > 0.0, out, np.inf))

    def smooth(s: Array) -> Array:
        return unit_veil(s, np.broadcast_to(up, s.shape)) / -np.expm1(-s / length_m)[..., None]

    # rays end at the surface, but interpolation reads nodes beyond it: continue linearly as far as the next flatter
    # ray reaches, and over two cells
    t, t_out = table_coordinate(s, length_m), table_coordinate(out, length_m)
    before = (1.0 - STEP) * np.minimum(out, s[:, -1:])
    at_surface = smooth(np.concatenate([before, before / (1.0 - STEP)], axis=1))
    slope = (at_surface[:, 1] - at_surface[:, 0])[:, None] / (t_out - table_coordinate(before, length_m))[..., None]
    flatter = table_coordinate(camera_depth_m / np.maximum(up - up_step, 1e-9), length_m)
    beyond = np.where(up > 0.0, np.clip(t - t_out, 0.0, flatter - t_out + 2.0 / (size[1] - 1)), 0.0)
    return smooth(inside) + beyond[..., None] * np.where((beyond > 0.0)[..., None], slope, 0.0)


def _attenuation(light: BandModel, camera_depth_m: float, length_m: float) -> Array:
    count = LAYERED_DEPTHS if isinstance(light.model, LayeredModel) else ATTENUATION_SIZE[0]
    depth = np.minimum(lengths(count, length_m), light.deepest_m)[:, None]
    s = np.maximum(lengths(ATTENUATION_SIZE[1], length_m), STEP * length_m)[None, :]
    return -light.transmittance_log(s, depth, camera_depth_m) / s[..., None]


def _diffuse(light: BandModel, camera: float, length_m: float, *, rough: bool) -> Array:
    depth, normal = depth_nodes(length_m, light.deepest_m, rough=rough), normal_nodes(rough=rough)[:, None]
    lobes = light.bands.lobes
    here = light.model.irradiance(camera, normal[:, 0]) @ lobes
    return diffuse_table(light.model.irradiance(depth, normal) @ lobes, here, depth, camera)


def diffuse_table(light: Array, here: Array, depth_m: Array, camera_m: float) -> Array:
    """Return `MediumTable.diffuse` (N, D, 3) of irradiances (N, D, 3) at depths (D,), and those (N, 3) at the camera.

    Where a depth is the camera's, it is that of the next one.
    """
    below = (depth_m - camera_m)[:, None]
    fall = np.log(np.maximum(here, _TINY))[:, None] - np.log(np.maximum(light, _TINY))
    near = np.abs(below[:, 0]) < STEP * (depth_m[1] + camera_m)
    table = fall / np.where(near[:, None], 1.0, below)
    if np.any(near):
        at = np.flatnonzero(near)
        table[:, at] = 0.5 * (table[:, np.maximum(at - 1, 0)] + table[:, np.minimum(at + 1, len(depth_m) - 1)])
    return np.asarray(table)


def beam_tables(light: BandModel, length_m: float, sun_up: float = HIGH_SUN_UP) -> list[Array]:
    """Return the attenuations `beam` and `unscattered` (DEPTH_SIZE, 3) [1/m] over paths from the surface.

    sun_up: y of the direction to the sun, which counts in layers: a path of length p ends at the depth p sun_up.
    """
    path = np.maximum(lengths(DEPTH_SIZE, length_m), STEP * length_m)[:, None]
    rates = mean_rates(light.model, 0.0, sun_up * path[:, 0])
    return [(-light.bands.log_light(-rate * path) / path).astype(np.float32) for rate in rates]


def compress_gamut(rgb: ArrayLike) -> Array:
    """Return linear Rec.709 colours (..., 3) with no negative channel and the luminance they had (0 if negative)."""
    c = vectors("rgb", rgb).astype(np.float64, copy=False)
    largest = np.maximum(c.max(axis=-1, keepdims=True), 0.0)
    d = 1.0 - np.divide(c, largest, out=np.ones(c.shape), where=largest > 0.0)
    x = np.maximum(d - GAMUT_THRESHOLD, 0.0) / (1.0 - GAMUT_THRESHOLD)
    compressed = GAMUT_THRESHOLD + (1.0 - GAMUT_THRESHOLD) * x / (1.0 + x**GAMUT_POWER) ** (1.0 / GAMUT_POWER)
    mapped = largest * (1.0 - np.where(d > GAMUT_THRESHOLD, compressed, d))
    before, after = luminance(c)[..., None], luminance(mapped)[..., None]
    return mapped * np.divide(np.maximum(before, 0.0), after, out=np.ones(before.shape), where=after > 0.0)


_LEAST = 1e-300
"""Least irradiance that a logarithm is taken of: the smallest normal double is 2e-308."""
_LEAST_LIGHT = 1e-250
"""Irradiance at `deepest_m`, far enough above `_LEAST` that products of it with a transmittance do not reach that."""


class BandModel:
    """A model at the wavelengths of a sensor's bands."""

    def __init__(self, model: SpectralModel, bands: Bands) -> None:
        self.model, self.bands = model, bands

    def display(self, spectrum: Array) -> Array:
        """Return RGB (..., 3) within the gamut of spectra (..., n) relative to the illuminant."""
        rgb = self.bands.rgb(spectrum)
        return compress_gamut(rgb) if self.bands.signed else rgb

    def fading_length_m(self, depth_m: float) -> float:
        """Return the distance [m] over which the downwelling light about a depth falls to 1/e.

        Where no light is left it is a thousandth of the depth, from above.
        """
        depth_m = min(depth_m, self.deepest_m)
        step = 1e-3 * depth_m
        here, below = np.abs(self.bands.weight).sum(axis=1) @ self.model.irradiance(
            np.array([depth_m, depth_m + step]), 1.0
        ).T  # fmt: skip
        return float(step / np.log(here / below)) if below > 0.0 else step

    def transmittance_log(self, distance_m: Array, depth_m: Array, camera_m: ArrayLike) -> Array:
        """Return the logarithm (..., 3) of the transmittance of a grey object at a depth, a distance from a camera."""
        light = self._log_irradiance(depth_m)
        s = np.asarray(distance_m, np.float64)[..., None]
        lost = mean_rates(self.model, camera_m, depth_m)[0] * s
        return self.bands.log_light(light - lost) - self.bands.log_light(light)

    def ambient_log(self, depth_m: Array) -> Array:
        """Return the logarithm (..., 3) of the downwelling irradiance at depths."""
        return self.bands.log_light(self._log_irradiance(depth_m))

    def _log_irradiance(self, depth_m: Array) -> Array:
        return np.log(np.maximum(self.model.irradiance(depth_m, 1.0), _LEAST))

    @functools.cached_property
    def deepest_m(self) -> float:
        """Depth [m] at which the light is too weak for double precision; used for all greater depths."""
        depth = np.geomspace(0.1, 1e6, 300)
        light = self.model.irradiance(depth, 1.0)[:, np.argmin(self.model.extinction)]
        return float(depth[light > _LEAST_LIGHT][-1])


_WHOLE = 1.0 - 1e-4
"""Most part of the far veil that a level ray of one fading length has in the formation model."""


def fitted_formation(solved: BandModel, camera_depth_m: float, *, one_attenuation: bool) -> FormationModel:
    """Return the constants that agree with a solved field on a level ray of one fading length at the camera's depth.

    one_attenuation: beta_B = beta_D (Koschmieder), else beta_B is fitted to the veil.
    """
    depth, s = camera_depth_m, solved.fading_length_m(camera_depth_m)
    direct = -solved.transmittance_log(np.array(s), np.array(depth), depth) / s
    far = solved.display(solved.model.inscatter(np.array(1e4 * s), depth, np.array(0.0)))
    near = solved.display(solved.model.inscatter(np.array(s), depth, np.array(0.0)))
    # a channel whose veil is brighter near by than far away, as of blue in yellow water, is whole at that distance
    share = np.clip(near / np.maximum(far, _LEAST_LIGHT), 0.0, _WHOLE)
    backscatter = direct if one_attenuation else -np.log1p(-share) / s
    log = solved.ambient_log(np.array([depth, 0.0]))
    return FormationModel(direct, (log[1] - log[0]) / depth, backscatter, far)
