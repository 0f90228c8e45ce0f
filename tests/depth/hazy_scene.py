# SPDX-License-Identifier: Apache-2.0
"""A scene with exact distances: floor, walls, rocks, poles and fish in haze, under moving caustics and particles.

Surfaces are planes, balls and upright cylinders, met in closed form. Their albedo is a solid noise of six octaves. The
caustics are those of a wave surface (`caustic_map`), laid along the beam of the sun; a strength of 2 or 3 doubles or
triples their deviation from the mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mr360uw.base.sphere import directions, frame_from_direction, yaw_matrix
from mr360uw.caustics import GerstnerSea, caustic_map
from mr360uw.jit import fast
from mr360uw.types import Floats

FISHES, MEETING_S = 4, 3.0
"""Fish beside the first, and when they are about the camera [s]."""
FLOOR, WALL, ROCK, POLE, FISH, WATER = range(6)
_LATTICE, _TILE_M, _MAP = 32, 8.0, 256
_HAZE = np.array([0.25, 0.10, 0.08])
_VEIL = np.array([0.08, 0.28, 0.36])


@fast
def _noise(lattice, x, y, z):
    n = lattice.shape[0]
    fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
    u, v, w = x - fx, y - fy, z - fz
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    i, j, k = int(fx) % n, int(fy) % n, int(fz) % n
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
                total += weight * lattice[(i + a) % n, (j + b) % n, (k + c) % n]
    return total


@fast
def _trace(origin, rays, planes, balls, poles, fish, lattice, light, sun, look, haze, veil, image, distance, kind):
    """look: (roughness of the spectrum, contrast, fraction of the sun's light)."""
    roughness, contrast, share = look
    size = light.shape[0]
    for p in range(rays.shape[0]):
        dx, dy, dz = rays[p, 0], rays[p, 1], rays[p, 2]
        best, what, nx, ny, nz, swimmer = 1e9, 5, 0.0, 1.0, 0.0, 0
        for n in range(planes.shape[0]):
            a, b, c, d = planes[n, 0], planes[n, 1], planes[n, 2], planes[n, 3]
            rate = a * dx + b * dy + c * dz
            if rate < -1e-9:
                t = -(a * origin[0] + b * origin[1] + c * origin[2] + d) / rate
                if 0.0 < t < best and origin[1] + t * dy < planes[n, 4]:
                    best, nx, ny, nz = t, a, b, c
                    what = 0 if b > 0.9 else 1
        for n in range(balls.shape[0] + fish.shape[0]):
            ball = balls[n] if n < balls.shape[0] else fish[n - balls.shape[0]]
            ox, oy, oz = origin[0] - ball[0], origin[1] - ball[1], origin[2] - ball[2]
            half = ox * dx + oy * dy + oz * dz
            inside = half * half - (ox * ox + oy * oy + oz * oz - ball[3] * ball[3])
            if inside > 0.0:
                t = -half - np.sqrt(inside)
                if 0.0 < t < best:
                    best, what, swimmer = t, 2 if n < balls.shape[0] else 4, n - balls.shape[0]
                    nx, ny, nz = (ox + t * dx) / ball[3], (oy + t * dy) / ball[3], (oz + t * dz) / ball[3]
        for n in range(poles.shape[0]):
            ox, oz, r = origin[0] - poles[n, 0], origin[2] - poles[n, 1], poles[n, 2]
            a = dx * dx + dz * dz
            half = ox * dx + oz * dz
            inside = half * half - a * (ox * ox + oz * oz - r * r)
            if inside > 0.0 and a > 0.0:
                t = (-half - np.sqrt(inside)) / a
                if 0.0 < t < best and origin[1] + t * dy < poles[n, 3]:
                    best, what = t, 3
                    nx, ny, nz = (ox + t * dx) / r, 0.0, (oz + t * dz) / r
        kind[p] = what
        if what == 5:
            distance[p] = np.inf
            for c in range(3):
                image[p, c] = veil[c] * (1.0 + 0.3 * dy)
            continue
        distance[p] = best
        x, y, z = origin[0] + best * dx, origin[1] + best * dy, origin[2] + best * dz
        if what == 4:  # the texture swims along
            x, y, z = x - fish[swimmer, 0], y - fish[swimmer, 1], z - fish[swimmer, 2]
        albedo, scale, weight = 0.0, 1.7, 1.0
        for _ in range(6):
            albedo += weight * _noise(lattice, x * scale + 5.3, y * scale + 1.7, z * scale + 8.1)
            scale *= 2.1
            weight *= roughness
        albedo = min(max(0.35 + contrast * albedo, 0.03), 0.9)
        facing = nx * sun[0] + ny * sun[1] + nz * sun[2]
        beam = 0.0
        if facing > 0.0:
            u = ((x - y * sun[0] / sun[1]) / 8.0 * size) % size
            v = ((z - y * sun[2] / sun[1]) / 8.0 * size) % size
            i, j = int(u) % size, int(v) % size
            s, t = u - np.floor(u), v - np.floor(v)
            k, m = (i + 1) % size, (j + 1) % size
            near = (1 - s) * light[j, i] + s * light[j, k]
            beam = facing / sun[1] * ((1 - t) * near + t * ((1 - s) * light[m, i] + s * light[m, k]))
        lit = albedo * (share * beam + (1.0 - share) * (0.6 + 0.4 * ny))
        for c in range(3):
            seen = np.exp(-haze[c] * best)
            image[p, c] = seen * lit + (1.0 - seen) * veil[c] * (1.0 + 0.3 * dy)


@dataclass(frozen=True)
class HazyScene:
    """A scene by its seed. caustics: strength of the caustics' deviation from their mean; 0: even light."""

    seed: int = 1
    caustics: float = 1.0
    particles: int = 150
    poles: bool = False
    fish: bool = False
    haze: Floats = field(default_factory=_HAZE.copy)
    veil: Floats = field(default_factory=_VEIL.copy)
    noise: float = 0.004
    speed_m_s: float = 0.4

    def __post_init__(self) -> None:
        r = np.random.default_rng([self.seed, 36])
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        put("lattice", r.uniform(-1.0, 1.0, (_LATTICE,) * 3).astype(np.float32))
        put("height_m", r.uniform(1.4, 2.2))
        yaw = r.uniform(0.0, 2.0 * np.pi)
        walls = []
        for k in range(int(r.integers(2, 4))):  # reefs around: open water over them and between them
            a = yaw + k * 2.1 + r.uniform(-0.3, 0.3)
            walls.append([np.cos(a), 0.15, np.sin(a), r.uniform(3.0, 6.0), r.uniform(0.5, 2.5)])
        planes = np.array([[0.0, 1.0, 0.0, self.height_m, 1e9], *walls])
        planes[:, :4] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
        put("planes", planes)
        balls = []
        for _ in range(14):
            a, d, size = r.uniform(0, 2 * np.pi), r.uniform(1.6, 6.0), r.uniform(0.25, 0.8)
            balls.append([d * np.cos(a), -self.height_m + 0.3 * size, d * np.sin(a) - 0.5, size])
        put("balls", np.array(balls))
        angle = r.uniform(0, 2 * np.pi, 4)
        post = np.stack([2.2 * np.cos(angle), 2.2 * np.sin(angle), np.full(4, 0.03), np.full(4, 0.6)], axis=1)
        put("posts", post if self.poles else np.zeros((0, 4)))
        put("look", (r.uniform(0.65, 0.85), r.uniform(0.12, 0.22), 0.7))
        put("sea", GerstnerSea(wind_speed=r.uniform(2.5, 5.0), tile_m=_TILE_M, seed=self.seed))
        sun = np.array([r.uniform(-0.5, 0.5), 1.0, r.uniform(-0.5, 0.5)])
        put("sun", sun / np.linalg.norm(sun))
        put("depth_m", r.uniform(2.5, 5.0))
        put("turn", r.uniform(-0.06, 0.06))
        put("heading", r.uniform(-0.3, 0.3))
        put("dust", r.uniform(-4.0, 4.0, (self.particles, 3)))
        put("current", np.array([0.05, 0.0, 0.03]))
        put("shoal", self._shoal(np.random.default_rng([self.seed, 37])))

    def _shoal(self, r: np.random.Generator) -> tuple[Floats, Floats]:
        """Return centres at time 0 with radii, (n, 4), and velocities (n, 3) of fish that swim evenly.

        The first moves across the camera's path; the others stand about the camera at `MEETING_S`, and move anyhow.
        """
        first = np.array([[1.2, 0.1, -2.0, 0.2]])
        if not self.fish:
            return first[:0], np.zeros((0, 3))
        bearing = r.uniform(0.0, 2.0 * np.pi, FISHES)
        away = np.stack([np.cos(bearing), r.uniform(-0.35, 0.35, FISHES), np.sin(bearing)], axis=1)
        there = self.pose(MEETING_S)[0] + r.uniform(1.0, 2.5, FISHES)[:, None] * away
        velocity = r.normal(size=(FISHES, 3)) * [1.0, 0.3, 1.0]
        velocity *= (r.uniform(0.1, 0.5, FISHES) / np.linalg.norm(velocity, axis=1))[:, None]
        others = np.column_stack([there - MEETING_S * velocity, r.uniform(0.08, 0.2, FISHES)])
        return np.concatenate([first, others]), np.concatenate([[[0.35, 0.0, 0.0]], velocity])

    def pose(self, time_s: float) -> tuple[Floats, Floats]:
        """Return position and rotation of the camera, which swims ahead, bobs and turns."""
        along = self.speed_m_s * time_s
        place = np.array([np.sin(self.heading) * along, 0.06 * np.sin(1.3 * time_s), -np.cos(self.heading) * along])
        return place + np.array([0.05 * np.sin(0.9 * time_s), 0.0, 0.0]), yaw_matrix(self.turn * time_s)

    def light(self, time_s: float) -> Floats:
        """Return the irradiance of the sun (n, n) over its mean on the level below the waves."""
        if self.caustics == 0.0:
            return np.ones((2, 2), np.float32)
        ratio = caustic_map(self.sea, self.sun, self.depth_m, time_s, size=_MAP, grid=_MAP)
        return np.maximum(1.0 + self.caustics * (ratio - 1.0), 0.0).astype(np.float32)

    def see(self, width: int, time_s: float, samples: int = 2) -> tuple[Floats, Floats, np.ndarray]:
        """Return the linear picture (H, W, 3), the distances (H, W) [m] and what is seen (H, W) at a time."""
        origin, rotation = self.pose(time_s)
        wide, high = width * samples, width // 2 * samples
        rays = directions(wide, high).reshape(-1, 3)
        image, far, kind = np.empty((len(rays), 3)), np.empty(len(rays)), np.empty(len(rays), np.uint8)
        begin, velocity = self.shoal
        shoal = np.column_stack([begin[:, :3] + time_s * velocity, begin[:, 3]])
        _trace(
            origin, np.ascontiguousarray(rays @ rotation.T), self.planes, self.balls, self.posts, shoal, self.lattice,
            self.light(time_s), self.sun, self.look, self.haze, self.veil, image, far, kind,
        )  # fmt: skip
        image = image.reshape(width // 2, samples, width, samples, 3).mean(axis=(1, 3))
        middle = samples // 2
        distance = far.reshape(high, wide)[middle::samples, middle::samples]
        kinds = kind.reshape(high, wide)[middle::samples, middle::samples]
        self._add_particles(image, distance, origin, rotation, time_s)
        r = np.random.default_rng([self.seed, round(time_s * 1000.0) + 100000])
        return np.maximum(image + r.normal(0.0, self.noise, image.shape), 0.0), distance, kinds

    def grey(self, width: int, time_s: float, samples: int = 2) -> Floats:
        """Return the codes of the green channel, (H, W) float32 in [0, 255]."""
        return (255.0 * np.clip(self.see(width, time_s, samples)[0][..., 1], 0.0, 1.0) ** (1 / 2.2)).astype(np.float32)

    def _add_particles(self, image: Floats, distance: Floats, origin: Floats, rotation: Floats, time_s: float) -> None:
        height, width = distance.shape
        offset = self.dust + self.current * time_s - origin
        away = (offset + 4.0) % 8.0 - 4.0
        near = np.linalg.norm(away, axis=1)
        x, y = frame_from_direction(away @ rotation, width, height)
        for i, j, d in zip(x.astype(int) % width, np.minimum(y.astype(int), height - 1), near, strict=True):
            if 0.15 < d < distance[j, i]:
                glow = min(0.0012 * width / 1024 / d, 0.0012) * 250.0
                radius = max(round(0.0025 / d * width / (2.0 * np.pi)), 0)
                rows = slice(max(j - radius, 0), j + radius + 1)
                image[rows, max(i - radius, 0) : i + radius + 1] += min(glow, 0.25)


def relative_error(found_m: Floats, truth_m: Floats) -> Floats:
    """Return the relative errors (H, W) of distances, infinite where one of the two is and the other is not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(found_m / truth_m - 1.0)
    return np.where(np.isinf(found_m) | np.isinf(truth_m), np.where(found_m == truth_m, 0.0, np.inf), error)
