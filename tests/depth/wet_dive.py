# SPDX-License-Identifier: Apache-2.0
"""A hazy scene in a type of water, by its solved light, as a camera records it: codes of 8 bits with noise."""

from __future__ import annotations

import functools

import cv2
import numpy as np
from scipy.interpolate import RegularGridInterpolator

from mr360uw.base.color import decode, encode
from mr360uw.base.sphere import directions
from mr360uw.depth import DepthMap, Panorama, distances
from mr360uw.depth.clip_water import LitFrame
from mr360uw.medium import Medium, Water
from mr360uw.medium.water import JerlovType
from mr360uw.medium.water_by_distance import SeenPlaces
from mr360uw.types import Floats
from tests.depth.hazy_scene import WATER, HazyScene

DEPTH_M = 5.0
_MAP_ERROR, _FULL_WELL, _READ = 0.015, 6000.0, 3.0
_NEIGHBOURS = 24


@functools.lru_cache(maxsize=8)
def medium(kind: JerlovType) -> Medium:
    """Return a water with its solved light."""
    return Medium(Water.jerlov(kind), camera_depth_m=DEPTH_M)


class WetDive:
    """A dive by its seed. kind: of the water. caustics: strength. gain: unknown exposure and white balance (3,)."""

    def __init__(self, seed: int, kind: JerlovType, caustics: float, speed_m_s: float = 0.4, width: int = 512) -> None:
        r = np.random.default_rng([seed, 77])
        clear = np.zeros(3)
        self.kind, self.seed, self.width = kind, seed, width
        self.scene = HazyScene(
            seed=seed, caustics=caustics, particles=0, noise=0.0, haze=clear, veil=clear, speed_m_s=speed_m_s
        )
        self.dust = HazyScene(seed=seed, caustics=0.0, particles=100)
        self.gain = r.uniform(0.5, 1.5) * r.uniform(0.85, 1.15, 3)
        self.lit = medium(kind).irradiance(DEPTH_M) / np.pi
        self.far, self.up = np.concatenate([[0.0], np.geomspace(0.05, 200.0, 200)]), np.linspace(-1.0, 1.0, 81)
        far, up = np.meshgrid(self.far, self.up)
        both = np.concatenate(
            [medium(kind).transmittance(far, DEPTH_M, 0.0 * up), medium(kind).veil(far, DEPTH_M, up)], -1
        )
        self.table = RegularGridInterpolator((self.up, np.arange(len(self.far))), both)
        self.open = np.maximum(medium(kind).radiance(np.full(81, DEPTH_M), np.minimum(self.up, 0.6)), 0.0)
        self.exposure = 1.0
        self.exposure = 0.6 / float(np.quantile(self.light(0.0)[0].max(axis=-1), 0.99)) * self.gain

    def light(self, time_s: float) -> tuple[Floats, Floats]:
        """Return the linear light (H, W, 3) of a time, without noise, and the distances (H, W) [m]."""
        image, distance, kind = self.scene.see(self.width, time_s, samples=1)
        up = (directions(self.width, self.width // 2) @ self.scene.pose(time_s)[1].T)[..., 1]
        place = np.interp(np.where(np.isfinite(distance), distance, 100.0), self.far, np.arange(len(self.far)))
        found = self.table(np.stack([up, place], axis=-1))
        light = image * self.lit * found[..., :3] + np.maximum(found[..., 3:], 0.0)
        beyond = np.stack([np.interp(up, self.up, channel) for channel in self.open.T], axis=-1)
        return self.exposure * np.where((kind == WATER)[..., None], beyond, light), distance

    def codes(self, time_s: float) -> tuple[Floats, Floats]:
        """Return the codes (H, W, 3) of a time, and the distances (H, W) [m]."""
        light, distance = self.light(time_s)
        self.dust._add_particles(light, distance, *self.scene.pose(time_s), time_s)
        r = np.random.default_rng([self.seed, round(1000.0 * time_s)])
        sigma = np.sqrt(np.maximum(light, 0.0) / _FULL_WELL + (_READ / _FULL_WELL) ** 2)
        light = np.clip(light + sigma * r.standard_normal(light.shape), 0.0, 1.0)
        return np.round(255.0 * encode(light, "srgb")).astype(np.float32), distance

    def frames(self, seconds: float, count: int, *, stereo: bool = False) -> list[LitFrame]:
        """Return frames of a clip with their distances: by stereo, or the true ones, off by 1.5 % here and there."""
        times = np.linspace(0.0, seconds, count)
        seen = [(t, self.codes(t)[0][..., 1]) for t in np.linspace(0.0, seconds, 2 * count + 1)] if stereo else []
        made = []
        for number, t in enumerate(times):
            codes, distance = self.codes(t)
            pose = self.scene.pose(t)
            if stereo:
                near = sorted((abs(at - t), at) for at, _ in seen if abs(at - t) > 1e-6)[:_NEIGHBOURS]
                greys = dict(seen)
                others = [Panorama(greys[at], *self.scene.pose(at)) for _, at in near]
                found = distances(Panorama(codes[..., 1], *pose), others)
            else:
                r = np.random.default_rng([self.seed, number, 9])
                off = cv2.resize(r.normal(0.0, _MAP_ERROR, (32, 64)).astype(np.float32), distance.shape[::-1])
                sure = np.isfinite(distance).astype(np.float32)
                found = DepthMap((distance * (1.0 + off)).astype(np.float32), sure)
            made.append(LitFrame(decode(codes / 255.0, "srgb").astype(np.float32), found, *pose))
        return made

    def truth(self, seen: SeenPlaces) -> tuple[Floats, Floats]:
        """Return attenuation (3,) [1/m] and veil (3,) of the clip."""
        near, far = np.percentile(seen.distance_m[seen.seen], (10.0, 90.0))
        passed = medium(self.kind).transmittance(np.array([near, far]), DEPTH_M, 0.0)
        return np.log(passed[0] / passed[1]) / (far - near), medium(self.kind).veil(1e4, DEPTH_M, 0.0) * self.exposure


class HazyDive(WetDive):
    """A dive in plain haze (Koschmieder 1924) of its own: L = L0 exp(-c d) + V exp(g u) (1 - exp(-c d)).

    tilted: whether g is 0 to 2, else it is 0. u: y of the direction, up to .6, beyond which the surface is seen.
    """

    def __init__(self, seed: int, caustics: float, width: int = 512, *, tilted: bool = False) -> None:
        super().__init__(seed, "II", caustics, width=width)
        r = np.random.default_rng([seed, 55])
        # Red is lost fastest, and green or blue least
        red, one, other = np.sort(np.exp(r.uniform(np.log(0.05), np.log(0.35), 3)))[::-1]
        self.haze = np.array([max(red, 0.2), *((one, other) if r.random() < 0.6 else (other, one))])
        self.veil = r.uniform(0.3, 1.0, 3) * np.array([0.03, 0.1, 0.12])
        slope = r.uniform(0.0, 2.0) if tilted else 0.0
        far, up = np.meshgrid(self.far, np.minimum(self.up, 0.6))
        left, shown = np.exp(-far[..., None] * self.haze), self.veil * np.exp(slope * up)[..., None]
        self.table = RegularGridInterpolator(
            (self.up, np.arange(len(self.far))), np.concatenate([left, shown * (1.0 - left)], axis=-1)
        )
        self.lit, self.open = np.full(3, 0.3 * r.uniform(0.5, 1.5)), shown[:, 0]
        self.exposure = 1.0
        self.exposure = 0.6 / float(np.quantile(self.light(0.0)[0].max(axis=-1), 0.99)) * self.gain

    def truth(self, seen: SeenPlaces) -> tuple[Floats, Floats]:  # noqa: ARG002 - the same at all distances
        """Return attenuation (3,) [1/m] and veil (3,) of the clip."""
        return self.haze, self.veil * self.exposure
