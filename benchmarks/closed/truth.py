# SPDX-License-Identifier: Apache-2.0
"""Pictures of a dive by the generator, and the same with a body in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from benchmarks.closed.bodies import Body, body_of
from benchmarks.closed.dives import Dive
from benchmarks.closed.gathering import Caustics, Gathering, GroundPatch, WaterTables
from mr360uw import surface
from mr360uw.base.color import luminance
from mr360uw.base.constants import PI
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.medium import Water
from mr360uw.types import Floats, View

_SUB = 3
"""Rays of a pixel of body and shadow along each axis."""
_WHITE_SHARE = 0.05
"""Fraction of the sphere that the camera's exposure leaves above white."""
_CHANGED = 0.03
"""Relative change of the floor, in any channel, from which on a pixel counts as shadow."""
_COVERED = 0.99


@dataclass(frozen=True, eq=False)
class TruePicture:
    """One frame. plate, truth: (H, W, 3) without and with the body, scene radiance. body: pixels that it covers;
    shadow: pixels of the floor that it changes.
    """

    plate: Floats
    truth: Floats
    body: NDArray[np.bool_]
    shadow: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Stage:
    """A dive with its body and the light that does not change with the waves."""

    dive: Dive
    width: int

    @cached_property
    def water(self) -> WaterTables:
        """Its water."""
        return WaterTables(self.dive)

    @cached_property
    def body(self) -> Body:
        """Its body."""
        return body_of(self.dive)

    @cached_property
    def lit(self) -> tuple[Floats, GroundPatch]:
        """Ambient irradiance (V, 3) of the body's vertices and what it leaves on the floor, each with the other's."""
        dive, water, body = self.dive, self.water, self.body
        shade = Gathering(dive, water, body).ground_patch()
        first = Gathering(dive, water, body, None, shade)
        beam = first.beam(body.starts, body.normals)
        glow = (first.ambient(body.starts, body.normals) + beam) * dive.albedo / PI
        shade = Gathering(dive, water, body, glow).ground_patch()
        return Gathering(dive, water, body, glow, shade).ambient(body.starts, body.normals), shade

    @property
    def view(self) -> View:
        """The camera."""
        return View(self.width, self.width // 2, np.zeros(3), surface_y_m=self.dive.camera_depth_m)

    def plate(self, time_s: float, samples: int) -> Floats:
        """Return the generator's picture (H, W, 3)."""
        dive = self.dive
        return surface.picture(
            dive.sea, dive.dome, dive.floor, self.view, Water.jerlov(dive.water), sun=dive.sun, time_s=time_s,
            samples=samples,
        ).radiance  # fmt: skip

    def frame(self, plate: Floats, time_s: float) -> TruePicture:
        """Return a frame with the body. plate: the generator's picture at that time."""
        dive, truth = self.dive, plate.copy()
        body, shadow = np.zeros(plate.shape[:2], bool), np.zeros(plate.shape[:2], bool)
        rows, columns = np.nonzero(self._touched())
        place = (np.arange(_SUB) + 0.5) / _SUB
        shift = np.stack(np.meshgrid(place, place), axis=-1).reshape(-1, 2)
        ray = self.view.directions(
            (columns[:, None] + shift[:, 0]).ravel(), (rows[:, None] + shift[:, 1]).ravel()
        ).reshape(-1, 3)
        low = float(self.body.points[:, 1].max())
        caustics = Caustics.of(self.dive, self.water, self.dive.camera_depth_m - low - 0.1, time_s)
        met, radiance = self._body(ray, caustics)
        below = ray[:, 1] < 0.0
        below[met] = False
        whole, left = self._floor(ray[below], caustics)
        covered, sums = np.zeros(len(ray)), np.zeros((2, len(ray), 3))
        covered[met], sums[0, below], sums[1, below] = 1.0, whole, left
        covered, sums = covered.reshape(len(rows), -1).mean(axis=1), sums.reshape(2, len(rows), -1, 3).mean(axis=2)
        ratio = sums[1] / np.maximum(sums[0], 1e-12)  # of pixels: the plate's are means over waves too
        ratio[np.all(sums[0] == 0.0, axis=1)] = 1.0
        middle = self.view.directions(columns + 0.5, rows + 0.5)
        distance = dive.above_floor_m / np.maximum(-middle[:, 1], 1e-6)
        veil = self._water_ahead(distance, middle[:, 1])[1]
        behind = plate[rows, columns]
        behind = np.where((middle[:, 1] < 0.0)[:, None], veil + (behind - veil) * ratio, behind)
        shown = np.zeros((len(ray), 3))
        shown[met] = radiance
        truth[rows, columns] = shown.reshape(len(rows), -1, 3).mean(axis=1) + (1.0 - covered)[:, None] * behind
        changed = np.where(middle[:, 1] < 0.0, np.abs(1.0 - ratio).max(axis=1), 0.0)
        body[rows, columns] = covered > _COVERED
        shadow[rows, columns] = (changed > _CHANGED) & (covered == 0.0)
        return TruePicture(plate, truth, body, shadow)

    def _touched(self) -> NDArray[np.bool_]:
        """Return the pixels (H, W) that may show the body or the floor near it."""
        dive, view = self.dive, directions(self.width, self.width // 2)
        center = self.body.points.mean(axis=0)
        reach = float(np.linalg.norm(self.body.points - center, axis=-1).max())
        distance = float(np.linalg.norm(center))
        near = view @ (center / distance) > np.cos(np.arcsin(min(reach / distance, 1.0)) + 4.0 * PI / self.width)
        with np.errstate(divide="ignore"):
            far = np.where(view[..., 1] < 0.0, dive.above_floor_m / -view[..., 1], np.inf)
        with np.errstate(invalid="ignore"):
            ground = self.lit[1]
            beside = np.abs(far[..., None] * view[..., [0, 2]] - ground.middle).max(axis=-1) < ground.half_m
            sun = dive.sun_in_water
            on_ray = far[..., None] * view - center  # its distance from the line from the middle towards the sun
            along = on_ray @ sun
            off = np.linalg.norm(on_ray - along[..., None] * sun, axis=-1)
        shaded = np.isfinite(far) & (off < 1.6 * reach + 0.1 * np.abs(along)) & (far < 40.0)
        return np.asarray(near | (np.isfinite(far) & (beside | shaded)))

    def _water_ahead(self, distance: Floats, up: Floats) -> tuple[Floats, Floats]:
        """Return transmittance and veil (n, 3) of camera rays, from the two tables about the camera's depth."""
        step = self.dive.camera_depth_m / 0.1
        low = int(step)
        a, b = (self.water.along(k, distance, up) for k in (low, low + 1))
        return tuple(p + (step - low) * (q - p) for p, q in zip(a, b, strict=True))  # type: ignore[return-value]

    def _body(self, ray: Floats, caustics: Caustics) -> tuple[NDArray[np.int64], Floats]:
        """Return which rays (n, 3) meet the body and the radiance (h, 3) that they bring to the camera."""
        body = self.body
        met, corners, weights = body.hit(np.zeros_like(ray), ray)
        point, normal, start, ambient = (
            np.einsum("hk,hkc->hc", weights, values[corners])
            for values in (body.points, body.normals, body.starts, self.lit[0])
        )
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        distance = np.linalg.norm(point, axis=-1)
        footprint = distance * self.view.pixel_rad / _SUB
        depth = self.dive.camera_depth_m - point[:, 1]
        beam = Gathering(self.dive, self.water, body).beam(start, normal, caustics.at(point, depth, footprint))
        passed, veil = self._water_ahead(distance, ray[met, 1])
        return met, veil + passed * self.dive.albedo / PI * (ambient + beam)

    def _floor(self, ray: Floats, caustics: Caustics) -> tuple[Floats, Floats]:
        """Return the irradiance (n, 3) of the floor that rays meet, without and with the body."""
        dive, water, shade = self.dive, self.water, self.lit[1]
        distance = dive.above_floor_m / -ray[:, 1]
        place = distance[:, None] * ray
        ambient, sharp, turned = water.on_floor
        depth = np.full(len(ray), dive.floor_depth_m)
        footprint = distance * self.view.pixel_rad / np.sqrt(-ray[:, 1])
        a, b = caustics.at(place, depth, footprint)
        place[:, 1] += 1e-4
        gathering = Gathering(dive, water, self.body)
        visible = [seen_level(gathering, place, rays) for rays in water.sun_directions]
        whole = ambient + sharp * a + turned * b
        left = ambient * shade.left(shade.ambient, place[:, 0], place[:, 2])
        left += sharp * a * visible[0][:, None] + turned * b * visible[1][:, None]
        return whole, left


def seen_level(gathering: Gathering, start: Floats, rays: Floats) -> Floats:
    """Return the fraction (n,) of a source's light on a level plane that the body leaves at points (n, 3)."""
    from benchmarks.closed.gathering import seen

    out = np.empty(len(start))
    for begin in range(0, len(start), 20000):
        part = slice(begin, begin + 20000)
        out[part] = seen(gathering.body, start[part], rays) @ rays[:, 1] / rays[:, 1].sum()
    return out


def exposure(plate: Floats) -> float:
    """Return the factor that leaves the brightest twentieth of the sphere above white."""
    weight = np.repeat(row_solid_angle(plate.shape[1], plate.shape[0]), plate.shape[1])
    light = luminance(plate).ravel()
    order = np.argsort(light)
    share = np.cumsum(weight[order]) / weight.sum()
    return 1.0 / float(light[order][np.searchsorted(share, 1.0 - _WHITE_SHARE)])
