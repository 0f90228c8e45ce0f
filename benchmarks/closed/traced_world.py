# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: NPY002 - numba has the legacy generator alone
"""Places of a path-traced world as a camera that swims sees them, and its open water: `water_from_motion.py traced`.

A world has a level floor, reefs that are large balls, and rocks that are small ones, in a type of water at a wavelength
of each channel, under the sun and an even sky, below a flat surface. Light is scattered by Henyey & Greenstein's phase
function as often as it is, and sent back by all surfaces. Nothing of it knows of the project's light in water.
"""

from __future__ import annotations

import numba
import numpy as np

from benchmarks.dive_truth import FAR, fresnel, going_on, hit_ball, leave_matt, turn_by
from mr360uw.base.optics import fresnel_from_below, refract_to_water
from mr360uw.base.sphere import direction_from_angles
from mr360uw.medium import Water
from mr360uw.medium.models import spectral_model
from mr360uw.medium.water import JerlovType
from mr360uw.medium.water_by_distance import SeenPlaces
from mr360uw.types import Floats

CHANNEL_NM = (610.0, 540.0, 460.0)
FRAMES, PLACES, PATHS, OPEN_PATHS = 10, 110, 2000, 4000
SURE_M, SURE_LEFT = 9.0, 0.1
"""Distance [m] up to which places are seen, and the fraction of green that is left of their light: of what is fainter
no stereo finds the distance."""
INDEX, MAP_ERROR = 1.34, 0.015
_ACROSS = np.linspace(-0.03, 0.03, 3)
"""Directions [rad] of the points of a place about its middle, as its frame sees it."""


@numba.njit(inline="always")
def _nearest(o, d, balls, bottom):
    """Return the distance of what a ray meets first, and its number: of a ball, -1 for the floor, -2 for neither."""
    t, hit = FAR, -2
    if d[1] < 0.0:
        t, hit = (bottom - o[1]) / d[1], -1
    for n in range(len(balls)):
        near = hit_ball(o, d, balls[n])
        if near < t:
            t, hit = near, n
    return t, hit


@numba.njit(inline="always")
def _albedo(x, y, z, channel):
    """Return the albedo of a solid texture of sines, from 0.1 to 0.6, of another tint in each channel."""
    wave = np.sin(2.1 * x + 1.7 * y) + np.sin(2.6 * y - 1.3 * z + 0.7) + np.sin(1.9 * z + 3.1 * x + 2.0 * np.sin(y))
    return 0.35 + 0.08 * wave + (0.05, 0.0, -0.05)[channel] * np.sin(0.9 * x - 1.1 * z)


@numba.njit
def _path(o, d, water, place, sun, balls, channel):
    """Return the light of one path. water: c, b/c, g. place: heights of surface and floor, light of the sky below."""
    c, share, g = water
    top, bottom, sky = place
    light, weight = 0.0, 1.0
    for _ in range(2000):
        t, hit = _nearest(o, d, balls, bottom)
        if hit == -2 and d[1] > 0.0:
            t = (top - o[1]) / d[1]
        s = -np.log(1.0 - np.random.random()) / c
        inside = s < t
        for i in range(3):
            o[i] += min(s, t) * d[i]
        if not inside and hit == -2:
            if np.random.random() >= fresnel(d[1], INDEX):
                return light + weight * sky
            o[1], d[1] = top - 1e-9, -d[1]
            continue
        # Add the sun's light that is sent on from here, then go on in a direction at random
        nx, ny, nz = 0.0, 1.0, 0.0
        if hit >= 0:
            ball = balls[hit]
            nx, ny, nz = (o[0] - ball[0]) / ball[3], (o[1] - ball[1]) / ball[3], (o[2] - ball[2]) / ball[3]
        if inside:
            weight *= share
            cosine = d[0] * sun[0] + d[1] * sun[1] + d[2] * sun[2]
            sent = (1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * cosine) ** 1.5)
        else:
            weight *= _albedo(o[0], o[1], o[2], channel)
            o[0], o[1], o[2] = o[0] + 1e-7 * nx, o[1] + 1e-7 * ny, o[2] + 1e-7 * nz
            sent = max(nx * sun[0] + ny * sun[1] + nz * sun[2], 0.0) / np.pi
        if sent > 0.0 and _nearest(o, sun[:3], balls, bottom)[1] == -2:
            light += weight * sent * sun[3] * np.exp(-c * (top - o[1]) / sun[1])
        if inside:
            q = (1.0 - g * g) / (1.0 - g + 2.0 * g * np.random.random())
            turn_by(d, (1.0 + g * g - q * q) / (2.0 * g), 2.0 * np.pi * np.random.random())
        else:
            leave_matt(d, nx, ny, nz)
        weight = going_on(weight)
        if weight == 0.0:
            return light
    return light


@numba.njit
def _mean_light(eyes, rays, paths, seed, water, place, sun, balls, channel):
    """Return the mean light (n,) that arrives at eyes (n, 3), each along one of m rays (n, m, 3) taken at random."""
    np.random.seed(seed)
    out, o, d = np.zeros(len(eyes)), np.zeros(3), np.zeros(3)
    for n in range(len(eyes)):
        for _ in range(paths):
            o[:], d[:] = eyes[n], rays[n, np.random.randint(rays.shape[1])]
            out[n] += _path(o, d, water, place, sun, balls, channel)
    return out / paths


@numba.njit
def _met(o, rays, balls, bottom):
    """Return distances (n,) at which rays (n, 3) from a point meet something, and its numbers (n,)."""
    far, what = np.zeros(len(rays)), np.zeros(len(rays), np.int64)
    for n in range(len(rays)):
        far[n], what[n] = _nearest(o, rays[n], balls, bottom)
    return far, what


def _directions(azimuth: Floats, elevation: Floats) -> Floats:
    return np.ascontiguousarray(np.moveaxis(direction_from_angles(azimuth, elevation), 0, -1))


class TracedWorld:
    """A world by its seed, in a type of water at wavelengths `CHANNEL_NM`."""

    def __init__(self, seed: int, kind: JerlovType) -> None:
        self.rng = r = np.random.default_rng([seed, 91])
        self.seed, self.kind, self.depth_m, self.bottom = seed, kind, r.uniform(3.0, 8.0), -r.uniform(1.6, 3.0)
        self.g, jerlov = r.uniform(0.85, 0.95), Water.jerlov(kind)
        self.absorption, self.scattering = jerlov.absorption(CHANNEL_NM), jerlov.scattering(CHANNEL_NM)
        # Reefs on two or three sides, and rocks on the floor
        turn, reefs = r.uniform(0.0, 2.0 * np.pi), int(r.integers(2, 4))
        angle = np.concatenate([turn + 2.1 * np.arange(reefs), r.uniform(0.0, 2.0 * np.pi, 10)])
        size = np.concatenate([r.uniform(3.0, 5.0, reefs), r.uniform(0.3, 0.9, 10)])
        away = np.concatenate([size[:reefs] + r.uniform(3.0, 5.0, reefs), r.uniform(2.0, 6.0, 10)])
        w = np.sort(CHANNEL_NM)
        own = Water.from_arrays(w, self.absorption[::-1], self.scattering[::-1], None, ("hg", self.g))
        self.extinction = spectral_model(own, w, "table").extinction[::-1]
        self.balls = np.stack(
            [away * np.cos(angle), self.bottom + 0.3 * size, away * np.sin(angle) - 2.0, size], axis=1
        )
        # Sun and sky, together 1 just below the surface
        share, up = r.uniform(0.4, 0.8), r.uniform(35.0, 75.0)
        sun = refract_to_water(direction_from_angles(r.uniform(-np.pi, np.pi), np.radians(up)), INDEX)
        mu = (np.arange(20000) + 0.5) / 20000
        passed = 2.0 * np.mean((1.0 - fresnel_from_below(mu, INDEX)) * mu)
        self.sun, self.sky = np.array([*sun, share / sun[1]]), (1.0 - share) / np.pi / passed

    def light(self, eyes: Floats, rays: Floats, paths: int) -> Floats:
        """Return the light (n, 3) that arrives at eyes (n, 3) along rays (n, m, 3)."""
        place = np.array([self.depth_m, self.bottom, self.sky])
        of_channel = []
        for k in range(3):
            c = self.absorption[k] + self.scattering[k]
            water = np.array([c, self.scattering[k] / c, self.g])
            of_channel.append(_mean_light(eyes, rays, paths, 10 * self.seed + k, water, place, self.sun, self.balls, k))
        return np.stack(of_channel, axis=-1)

    def seen(self) -> SeenPlaces:
        """Return what ten frames over 4 m show: places, and open water about the horizon."""
        eyes = np.stack([np.zeros(FRAMES), np.zeros(FRAMES), np.linspace(0.0, -4.0, FRAMES)], axis=1)
        # Look from every third frame at small patches of surfaces
        u, a = self.rng.uniform(-0.75, 0.4, 400), self.rng.uniform(-np.pi, np.pi, 400)
        points, reach = [], min(SURE_M, -np.log(SURE_LEFT) / self.extinction[1])
        for eye in eyes[::3]:
            b, e = (x.ravel() for x in np.meshgrid(_ACROSS, _ACROSS))
            rays = _directions(a[:, None] + b / np.sqrt(1.0 - u * u)[:, None], np.arcsin(u)[:, None] + e)
            far, what = (x.reshape(rays.shape[:2]) for x in _met(eye, rays.reshape(-1, 3), self.balls, self.bottom))
            good = (np.ptp(what, axis=1) == 0) & (far.max(axis=1) < reach) & (np.ptp(far, axis=1) < 0.35 * far[:, 4])
            points.append(eye + far[good][..., None] * rays[good])
        all_points = np.concatenate(points)
        chosen = all_points[self.rng.permutation(len(all_points))[:PLACES]]
        # Find which frames see them, and trace their light
        to = chosen[:, None] - eyes[:, None]
        far = np.linalg.norm(to, axis=-1)
        rays, middle = to / far[..., None], far[..., 4]
        met = np.stack([
            _met(eye, np.ascontiguousarray(rays[:, k].reshape(-1, 3)), self.balls, self.bottom)[0].reshape(-1, 9)
            for k, eye in enumerate(eyes)
        ], axis=1)  # fmt: skip
        up = rays[:, :, 4, 1]
        seen = np.all(np.abs(met / far - 1.0) < 0.02, axis=-1) & (np.abs(up) < 0.8)
        light = np.zeros((*seen.shape, 3))
        light[seen] = self.light(np.broadcast_to(eyes, (len(chosen), FRAMES, 3))[seen], rays[seen], PATHS)
        off = 1.0 + MAP_ERROR * self.rng.standard_normal(middle.shape)
        part = np.unique(np.floor(chosen[:, 4]).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
        open_up, shown = self.open_water()
        exposure = 0.6 / np.quantile(light[seen].max(axis=-1), 0.99)
        return SeenPlaces(exposure * light, middle * off, up, rays[:, :, 4, ::2], seen, part, open_up, exposure * shown)

    def open_water(self) -> tuple[Floats, Floats]:
        """Return y of directions (m,) and typical light (m, 3), of the least red that meet nothing within 20 m."""
        ups, light = np.linspace(-0.08, 0.32, 9), []
        for up in ups:
            rays = _directions(np.linspace(-np.pi, np.pi, 24, endpoint=False), np.full(24, np.arcsin(up)))
            rays = rays[_met(np.zeros(3), rays, self.balls, self.bottom)[0] > 20.0]
            found = self.light(np.zeros_like(rays), rays[:, None], OPEN_PATHS)
            red = found[:, 0] / found.sum(axis=1)
            light.append(np.median(found[red <= np.quantile(red, 0.3)], axis=0))
        return ups, np.array(light)

    def truth(self, seen: SeenPlaces) -> tuple[Floats, Floats]:
        """Return attenuation (3,) [1/m], by absorption and wide angles, and the typical light of the horizon (3,)."""
        level = np.array([np.interp(0.0, seen.open_up, one) for one in seen.open_light.T])
        return self.extinction, level
