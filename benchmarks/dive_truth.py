# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: NPY002 - numba has the legacy generator alone
"""Bodies near a bright floor against path tracing: python benchmarks/dive_truth.py trace|compare|pictures [name ...]
and light under a sun or over a floor without bodies: field|around

around: traces radiance by its azimuth from the sun into tests/data/around_sun.csv (20 minutes).
field: traces radiance and irradiance over a floor, without bodies, into tests/data/floor_field.csv (four minutes).
trace: renders the dives of tests/lit_dives.py by path tracing into tests/data/lit_dives.npz (20 s of a core a dive).
compare: lays a ball and a box into their plates by both renderers and prints means over regions over the truth.
pictures: prints the mean square of whole composites less a trace, over the noise of two traces (20 s a dive).
"""

from __future__ import annotations

import csv
import json
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numba
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from mr360uw.base.optics import fresnel_from_below  # noqa: E402
from mr360uw.base.sphere import directions  # noqa: E402
from mr360uw.medium.phase import phase_function  # noqa: E402
from tests.lit_dives import DATA, DIVES, PLATE, SIZE, LitDive, compared, composed, plate_of, regions_of  # noqa: E402

PLATE_PATHS, REGION_PATHS = 1500, 800_000
"""Paths a pixel of the plate and a region, in each channel: noise of 0.2 % in a region."""
PEAK_RAD = 0.01
"""Angle [rad] within which a tabulated phase function is level: its peak would be noise."""
_CLOSE, FAR = 1e-6, 1e30


def phase_table(phase: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return angles [rad], the phase function there and its cumulative integral over the sphere."""
    angle = np.concatenate([np.geomspace(PEAK_RAD, 0.2, 400), np.linspace(0.2, np.pi, 800)[1:]])
    angle = np.concatenate([[0.0], angle])
    value = phase_function(phase, np.maximum(angle, PEAK_RAD))
    f = 2.0 * np.pi * value * np.sin(angle)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * np.diff(angle))])
    return angle, value / total[-1], total / total[-1]


def turned_share(phase: Any) -> float:
    """Return the fraction of the scattering that `phase_table` holds: the rest turns by so little that none is seen."""
    return float(phase_function(phase, np.pi) / phase_table(phase)[1][-1])


@numba.njit(inline="always")
def _between(x, xs, ys):
    i = min(max(np.searchsorted(xs, x), 1), len(xs) - 1)
    w = min(max((x - xs[i - 1]) / max(xs[i] - xs[i - 1], 1e-300), 0.0), 1.0)
    return ys[i - 1] * (1.0 - w) + ys[i] * w


@numba.njit(inline="always")
def fresnel(cosine, n):
    """Return what the surface sends back of light from below; n: refractive index."""
    s2 = (1.0 - cosine * cosine) * n * n
    if s2 >= 1.0:
        return 1.0
    ca = np.sqrt(1.0 - s2)
    p, q = (cosine - n * ca) / (cosine + n * ca), (n * cosine - ca) / (n * cosine + ca)
    return 0.5 * (p * p + q * q)


@numba.njit(inline="always")
def hit_ball(o, d, ball):
    """Return the distance to a ball, `FAR` for none; ball: middle and radius."""
    x, y, z = o[0] - ball[0], o[1] - ball[1], o[2] - ball[2]
    b = x * d[0] + y * d[1] + z * d[2]
    q = b * b - (x * x + y * y + z * z - ball[3] * ball[3])
    if q <= 0.0 or -b - np.sqrt(q) < _CLOSE:
        return FAR
    return -b - np.sqrt(q)


@numba.njit(inline="always")
def _hit_box(o, d, box):
    """Return distance, axis and side; box: middle, half sizes, cosine and sine of its yaw."""
    c, s = box[6], box[7]
    x, y, z = o[0] - box[0], o[1] - box[1], o[2] - box[2]
    lo = (x * c - z * s, y, x * s + z * c)
    ld = (d[0] * c - d[2] * s, d[1], d[0] * s + d[2] * c)
    near, far, axis, side = -FAR, FAR, 0, 0.0
    for i in range(3):
        half = box[3 + i]
        if abs(ld[i]) < 1e-14:
            if abs(lo[i]) > half:
                return FAR, 0, 0.0
            continue
        a, b = (-half - lo[i]) / ld[i], (half - lo[i]) / ld[i]
        of = -1.0
        if a > b:
            a, b, of = b, a, 1.0
        if a > near:
            near, axis, side = a, i, of
        far = min(far, b)
    if near < far and near > _CLOSE:
        return near, axis, side
    return FAR, 0, 0.0


@numba.njit(inline="always")
def turn_by(d, cosine, turn):
    """Turn a unit vector by an angle, about itself by another."""
    sine = np.sqrt(max(0.0, 1.0 - cosine * cosine))
    x, y, z = d[0], d[1], d[2]
    sign = 1.0 if z >= 0.0 else -1.0
    k = -1.0 / (sign + z)
    b = x * y * k
    ca, sa = sine * np.cos(turn), sine * np.sin(turn)
    d[0] = ca * (1.0 + sign * x * x * k) + sa * b + cosine * x
    d[1] = ca * sign * b + sa * (sign + y * y * k) + cosine * y
    d[2] = -ca * sign * x - sa * y + cosine * z
    r = 1.0 / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    d[0] *= r
    d[1] *= r
    d[2] *= r


@numba.njit(inline="always")
def leave_matt(d, nx, ny, nz):
    """Set a direction in which a matt surface of a normal sends light on, at random."""
    d[0], d[1], d[2] = nx, ny, nz
    turn_by(d, np.sqrt(1.0 - np.random.random()), 2.0 * np.pi * np.random.random())


@numba.njit(inline="always")
def going_on(weight):
    """Return the weight with which a path goes on, 0 where it ends: faint ones do so at random, and the others make up
    for them.
    """
    if weight >= 0.1:
        return weight
    return 0.1 if np.random.random() <= weight / 0.1 else 0.0


@numba.njit
def hit_mesh(o, d, mesh, any_):
    """Return the distance to the nearest triangle of a mesh, or to any, its number (-1: none), and where on it.

    mesh: nodes (m, 8) of a tree of boxes, each its two corners, its right child or first triangle, and its number of
    triangles; triangles (n, 3, 3), their normals (n, 3), their places in the texture (n, 3, 2), and that, (h, w).
    """
    nodes, triangles = mesh[0], mesh[1]
    best, who, at_u, at_v, top = FAR, -1, 0.0, 0.0, min(len(nodes), 1)
    stack = np.zeros(64, np.int64)
    while top > 0:
        top -= 1
        number = stack[top]
        node, near, far = nodes[number], -FAR, FAR
        for i in range(3):
            inverse = 1.0 / (d[i] if abs(d[i]) > 1e-12 else 1e-12)
            a, b = (node[i] - o[i]) * inverse, (node[3 + i] - o[i]) * inverse
            near, far = max(near, min(a, b)), min(far, max(a, b))
        if near > far or far < 0.0 or near > best:
            continue
        if node[7] == 0.0:
            stack[top], stack[top + 1] = number + 1, int(node[6])
            top += 2
            continue
        for t in range(int(node[6]), int(node[6] + node[7])):
            p = triangles[t]
            ax, ay, az = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
            bx, by, bz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
            qx, qy, qz = d[1] * bz - d[2] * by, d[2] * bx - d[0] * bz, d[0] * by - d[1] * bx
            size = ax * qx + ay * qy + az * qz
            if abs(size) < 1e-18:
                continue
            x, y, z = o[0] - p[0, 0], o[1] - p[0, 1], o[2] - p[0, 2]
            rx, ry, rz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
            u = (x * qx + y * qy + z * qz) / size
            v = (d[0] * rx + d[1] * ry + d[2] * rz) / size
            reach = (bx * rx + by * ry + bz * rz) / size
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and _CLOSE < reach < best:
                best, who, at_u, at_v = reach, t, u, v
                if any_:
                    return best, who, at_u, at_v
    return best, who, at_u, at_v


@numba.njit(inline="always")
def _is_lit(o, sun, ball, box, mesh):
    """Return whether no body is between a place and the sun."""
    free = hit_ball(o, sun[:3], ball) == FAR and _hit_box(o, sun[:3], box)[0] == FAR
    return free and hit_mesh(o, sun[:3], mesh, True)[1] < 0


@numba.njit
def _trace(o, d, water, floor, place, sun, table, ball, box, mesh, bodies):
    """Return the radiance of one path.

    water: c, b/c, g (or 2: of the table), n. floor: albedo. place: heights [m] of surface and floor over the camera,
    radiance of the sky in the water. sun: direction and irradiance across the beam just below the surface. table:
    angles, phase function, cumulative. ball, box: albedo last. mesh: see `hit_mesh`.
    """
    c, w0, g, n = water
    top, bottom, sky = place
    light, weight = 0.0, 1.0
    for _ in range(2000):
        t, kind, axis, side, who, u, v = FAR, 0, 0, 0.0, -1, 0.0, 0.0
        if d[1] < 0.0:
            t, kind = (bottom - o[1]) / d[1], 1
        elif d[1] > 0.0:
            t, kind = (top - o[1]) / d[1], 2
        if bodies:
            to_ball = hit_ball(o, d, ball)
            if to_ball < t:
                t, kind = to_ball, 3
            to_box, axis, side = _hit_box(o, d, box)
            if to_box < t:
                t, kind = to_box, 4
            to_mesh, who, u, v = hit_mesh(o, d, mesh, False)
            if to_mesh < t:
                t, kind = to_mesh, 5
        s = -np.log(1.0 - np.random.random()) / c
        if s < t:
            for i in range(3):
                o[i] += s * d[i]
            weight *= w0
            if not bodies or _is_lit(o, sun, ball, box, mesh):
                cosine = d[0] * sun[0] + d[1] * sun[1] + d[2] * sun[2]
                if g > 1.5:
                    p = _between(np.arccos(min(1.0, max(-1.0, cosine))), table[0], table[1])
                else:
                    p = (1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * cosine) ** 1.5)
                light += weight * p * sun[3] * np.exp(-c * (top - o[1]) / sun[1])
            part = np.random.random()
            if g > 1.5:
                cosine = np.cos(_between(part, table[2], table[0]))
            else:
                q = (1.0 - g * g) / (1.0 - g + 2.0 * g * part)
                cosine = (1.0 + g * g - q * q) / (2.0 * g)
            turn_by(d, cosine, 2.0 * np.pi * np.random.random())
        elif kind == 2:
            if np.random.random() >= fresnel(d[1], n):
                return light + weight * sky
            for i in range(3):
                o[i] += t * d[i]
            o[1], d[1] = top - 1e-9, -d[1]
        else:
            for i in range(3):
                o[i] += t * d[i]
            nx, ny, nz, albedo = 0.0, 1.0, 0.0, floor
            if kind == 3:
                albedo = ball[4]
                nx, ny, nz = (o[0] - ball[0]) / ball[3], (o[1] - ball[1]) / ball[3], (o[2] - ball[2]) / ball[3]
            elif kind == 4:
                albedo = box[8]
                if axis == 0:
                    nx, ny, nz = side * box[6], 0.0, -side * box[7]
                elif axis == 1:
                    nx, ny, nz = 0.0, side, 0.0
                else:
                    nx, ny, nz = side * box[7], 0.0, side * box[6]
            elif kind == 5:
                nx, ny, nz = mesh[2][who, 0], mesh[2][who, 1], mesh[2][who, 2]
                if nx * d[0] + ny * d[1] + nz * d[2] > 0.0:
                    nx, ny, nz = -nx, -ny, -nz
                at, (rows, columns) = mesh[3][who], mesh[4].shape
                across = at[0, 0] * (1.0 - u - v) + at[1, 0] * u + at[2, 0] * v
                up = at[0, 1] * (1.0 - u - v) + at[1, 1] * u + at[2, 1] * v
                albedo = mesh[4][int((1.0 - up % 1.0) * rows) % rows, int(across % 1.0 * columns) % columns]
            o[0] += 1e-7 * nx
            o[1] += 1e-7 * ny
            o[2] += 1e-7 * nz
            weight *= albedo
            facing = nx * sun[0] + ny * sun[1] + nz * sun[2]
            if facing > 0.0 and (not bodies or _is_lit(o, sun, ball, box, mesh)):
                light += weight * facing / np.pi * sun[3] * np.exp(-c * (top - o[1]) / sun[1])
            leave_matt(d, nx, ny, nz)
        weight = going_on(weight)
        if weight == 0.0:
            return light
    return light


NO_MESH = tuple(np.zeros(shape) for shape in ((0, 8), (0, 3, 3), (0, 3), (0, 3, 2), (1, 1)))


@numba.njit
def means(pixels, size, paths, seed, water, floor, place, sun, table, ball, box, mesh, bodies):
    """Return the mean radiance and its standard error (n, 2) of pixels (n, 2: row, column) of a picture."""
    np.random.seed(seed)
    out, o, d = np.zeros((len(pixels), 2)), np.zeros(3), np.zeros(3)
    for k in range(len(pixels)):
        total, square = 0.0, 0.0
        for _ in range(paths):
            lon = 2.0 * np.pi * ((pixels[k, 1] + np.random.random()) / size[1] - 0.5)
            lat = np.pi * (0.5 - (pixels[k, 0] + np.random.random()) / size[0])
            o[:] = 0.0
            d[0], d[1], d[2] = np.cos(lat) * np.sin(lon), np.sin(lat), -np.cos(lat) * np.cos(lon)
            one = _trace(o, d, water, floor, place, sun, table, ball, box, mesh, bodies)
            total += one
            square += one * one
        out[k, 0] = total / paths
        out[k, 1] = np.sqrt(max(square / paths - out[k, 0] ** 2, 0.0) / paths)
    return out


def channel(dive: LitDive, k: int) -> tuple[Any, ...]:
    """Return what the tracer asks of a channel of a dive."""
    c = dive.absorption[k] + dive.scattering[k]
    g = dive.phase[1] if isinstance(dive.phase, tuple) else 2.0
    table = phase_table("petzold" if isinstance(dive.phase, tuple) else dive.phase)
    return (
        np.array([c, dive.scattering[k] / c, g, dive.refractive_index]), dive.floor_albedo[k],
        np.array([dive.depth_m, -dive.height_m, dive.sky_radiance]), np.array([*dive.sun, dive.sun_irradiance]),
        table, np.array(dive.ball), np.array(dive.box),
    )  # fmt: skip


def traced(dive: LitDive, seed: int) -> dict[str, np.ndarray]:
    """Return the plate (H, W/2, 3) of a dive, of which the sun's plane is the middle, and means of regions (r, 3)."""
    height, width = PLATE
    rows, columns = np.mgrid[:height, : width // 2]
    pixels = np.stack([rows.ravel(), columns.ravel()], axis=1)
    plate, of_regions = [], []
    regions = regions_of(dive)
    for k in range(3):
        of = channel(dive, k)
        plate.append(means(pixels, PLATE, PLATE_PATHS, 10 * seed + k, *of, NO_MESH, False)[:, 0].reshape(height, -1))
        row = []
        for number, mask in enumerate(regions.values()):
            some = np.argwhere(mask)
            paths = -(-REGION_PATHS // len(some))
            found = means(some, SIZE, paths, 1000 * seed + 10 * number + k, *of, NO_MESH, True)
            row.append((found[:, 0].mean(), np.sqrt(np.sum(found[:, 1] ** 2)) / len(some)))
        of_regions.append(row)
    values = np.moveaxis(np.array(of_regions), 0, -1)
    return {"plate": np.stack(plate, -1).astype(np.float16), "mean": values[:, 0], "noise": values[:, 1]}


@numba.njit
def _light(up, azimuth, cosine, paths, seed, water, floor, place, sun, table, ball, box, mesh):
    """Return the mean radiance from directions of a height, or the mean over the cosine about a normal of that height,
    and the standard error. The sun's own beam is not in it. azimuth: of the directions from the sun's [rad]; nan: all.
    """
    np.random.seed(seed)
    o, d, total, square = np.zeros(3), np.zeros(3), 0.0, 0.0
    for _ in range(paths):
        o[:] = 0.0
        turn = 2.0 * np.pi * np.random.random() if np.isnan(azimuth) else azimuth
        across = np.sqrt(1.0 - up * up)
        d[0], d[1], d[2] = across * np.cos(turn), up, across * np.sin(turn)
        if cosine:
            turn_by(d, np.sqrt(1.0 - np.random.random()), 2.0 * np.pi * np.random.random())
        one = _trace(o, d, water, floor, place, sun, table, ball, box, mesh, False)
        total += one
        square += one * one
    mean = total / paths
    return mean, np.sqrt((square / paths - mean * mean) / paths)


FIELDS = (
    # absorption, scattering, g, albedo, floor_m, sun_up, sun_share, refractive_index
    (0.05, 0.20, 0.85, 0.5, 4.0, 0.80, 0.7, 1.0),
    (0.30, 0.40, 0.90, 0.3, 2.0, 0.95, 0.5, 1.0),
    (0.03, 0.30, 0.60, 0.8, 6.0, 0.70, 0.9, 1.34),
    (0.10, 0.10, 0.924, 0.2, 3.0, 0.85, 0.0, 1.34),
)
FIELD_PATHS = 3_000_000


def field() -> None:
    """Trace light over floors: radiances over the downwelling irradiance in the same place, and irradiances over it."""
    keys = [
        "absorption",
        "scattering",
        "g",
        "albedo",
        "floor_m",
        "sun_up",
        "sun_share",
        "refractive_index",
        "depth_m",
        "kind",
        "up",
        "value",
        "noise",
    ]
    rows, seed = [], 0
    for case in FIELDS:
        a, b, g, albedo, floor_m, up, share, n = case
        mu = (np.arange(20000) + 0.5) / 20000
        passed = 2.0 * np.mean((1.0 - fresnel_from_below(mu, n)) * mu)
        sun = np.array([np.sqrt(1.0 - up * up), up, 0.0, share / up])
        for depth in (0.3 * floor_m, 0.9 * floor_m):
            place = np.array([depth, depth - floor_m, (1.0 - share) / np.pi / passed])
            water = np.array([a + b, b / (a + b), g, n])
            of = water, albedo, place, sun, phase_table("petzold"), np.zeros(5), np.ones(9), NO_MESH
            found = []
            for kind, ups in (("irradiance", (1.0, 0.0, -1.0)), ("radiance", (-1.0, -0.4, 0.1, 0.5))):
                for one in ups:
                    seed += 1
                    mean, noise = _light(one, np.nan, kind == "irradiance", FIELD_PATHS, seed, *of)
                    found.append((kind, one, mean * (np.pi if kind == "irradiance" else 1.0), noise / mean))
            diffuse = found[0][2]
            whole = diffuse + share * np.exp(-(a + b) * depth / up)
            level_beam = share / up * np.sqrt(1.0 - up * up) / np.pi * np.exp(-(a + b) * depth / up)
            for kind, one, value, noise in found[1:]:
                of_beam = level_beam if kind == "irradiance" and one == 0.0 else 0.0  # a mean over the azimuth
                both = np.hypot(noise, found[0][3] * diffuse / whole)
                rows.append((*case, round(depth, 3), kind, one, f"{(value + of_beam) / whole:.6g}", f"{both:.1e}"))
            print(*rows[-1], flush=True)
    with (DATA.parent / "floor_field.csv").open("w", newline="") as file:
        csv.writer(file).writerows([keys, *rows])


SUNS = (
    # absorption, scattering, phase, albedo, floor_m, sun_up, refractive_index, depth_m
    (0.05, 0.10, "hg 0.924", 0.0, 40.0, 0.85, 1.0, 3.0),
    (0.05, 0.30, "hg 0.924", 0.5, 6.0, 0.75, 1.34, 2.0),
    (0.20, 0.40, "hg 0.7", 0.8, 2.0, 0.95, 1.0, 0.5),
    (0.05, 0.10, "petzold", 0.3, 8.0, 0.90, 1.34, 3.0),
    (0.10, 0.30, "petzold", 0.0, 30.0, 0.70, 1.0, 3.0),
)
VIEWS = ((0.0, 0.0), (0.0, 24.0), (0.0, 90.0), (0.0, 180.0), (-0.5, 24.0), (-0.5, 120.0), (-0.9, 180.0), (0.4, 60.0))
"""Height of a direction, and its azimuth from the sun [deg]."""
AROUND_PATHS = 12_000_000


def around() -> None:
    """Trace radiances under a sun alone by their azimuth from it, over the downwelling irradiance in the same place."""
    keys = ["absorption", "scattering", "phase", "albedo", "floor_m", "sun_up", "refractive_index", "depth_m", "up"]
    keys += ["azimuth_deg", "value", "noise"]
    rows = []
    for number, case in enumerate(SUNS):
        a, b, phase, albedo, floor_m, up, n, depth = case
        sun = np.array([np.sqrt(1.0 - up * up), up, 0.0, 1.0 / up])
        table = phase_table("petzold") if phase == "petzold" else phase_table("isotropic")
        g, turned = (2.0, b * turned_share(phase)) if phase == "petzold" else (float(phase.split()[1]), b)
        c = a + turned
        water, place = np.array([c, turned / c, g, n]), np.array([depth, depth - floor_m, 0.0])
        of = water, albedo, place, sun, table, np.zeros(5), np.ones(9), NO_MESH
        mean, error = _light(1.0, np.nan, True, AROUND_PATHS, 100 * number, *of)
        down = np.pi * mean + np.exp(-c * depth / up)
        for k, (height, azimuth) in enumerate(VIEWS):
            value, noise = _light(height, np.radians(azimuth), False, AROUND_PATHS, 100 * number + k + 1, *of)
            both = np.hypot(noise / value, np.pi * error / down)
            rows.append((*case, height, azimuth, f"{value / down:.6g}", f"{both:.1e}"))
            print(*rows[-1], flush=True)
    with (DATA.parent / "around_sun.csv").open("w", newline="") as file:
        csv.writer(file).writerows([keys, *rows])


def trace(names: list[str]) -> None:
    """Trace dives and write them beside those that are there."""
    known = dict(np.load(DATA)) if DATA.exists() else {}
    for number, (name, dive) in enumerate(DIVES.items()):
        if names and name not in names:
            continue
        start = time.time()
        known |= {f"{name}/{key}": value for key, value in traced(dive, number + 1).items()}
        known[f"{name}/dive"] = np.array(json.dumps(asdict(dive)))
        print(f"{name}: {time.time() - start:.0f} s", flush=True)
        np.savez_compressed(DATA, **known)


def compare(names: list[str]) -> None:
    """Print means over regions of both renderers over the truth."""
    for name in names or DIVES:
        for backend in ("reference", "gl"):
            with tempfile.TemporaryDirectory() as folder:
                rows = compared(name, backend, Path(folder))
            print(f"{name}, {backend}")
            for region, ratio, noise in rows:
                cells = "  ".join(f"{x:.3f}" for x in ratio)
                print(f"  {region:24s} {cells}   noise {np.max(noise):.3f}", flush=True)


WHOLE, WHOLE_PATHS = (48, 96), 700
"""Height and width of whole pictures, and the paths of a pixel in each of the two traces."""


def pictures(names: list[str]) -> None:
    """Print how far whole composites are off, and the plates without bodies, beside the noise of the traces.

    Left out is what is within 8 degrees of the sun, whose disc is painted into the plate.
    """
    height, width = WHOLE
    rows, columns = np.mgrid[:height, :width]
    pixels = np.stack([rows.ravel(), columns.ravel()], axis=1)
    side = SIZE[0] // height
    for name in names or [name for name, dive in DIVES.items() if isinstance(dive.phase, tuple)]:
        dive = DIVES[name]
        traces = np.array([
            [means(pixels, WHOLE, WHOLE_PATHS, seed + k, *channel(dive, k), NO_MESH, True)[:, 0] for k in range(3)]
            for seed in (5000, 6000)
        ])  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            composite = composed(name, "gl", Path(folder)).image_linear
        far = ((directions(width, height) @ dive.sun) < np.cos(np.radians(8.0))).ravel()
        noise = 0.5 * np.mean((traces[0] - traces[1])[:, far] ** 2, axis=1)
        size = np.sqrt(np.mean(noise / np.mean(traces[..., far] ** 2, axis=(0, 2))))
        line = f"{name:8s} noise {size:.3f}, mean square over that of the noise: "
        for label, image in (("composite", composite), ("plate", plate_of(name))):
            coarse = image.astype(np.float64).reshape(height, side, width, side, 3).mean(axis=(1, 3)).reshape(-1, 3).T
            line += f"{label} {np.mean(np.mean((coarse - traces)[..., far] ** 2, axis=(0, 2)) / noise):.2f}  "
        print(line, flush=True)


if __name__ == "__main__":
    command, *names = sys.argv[1:]
    if command in ("field", "around"):
        {"field": field, "around": around}[command]()
    else:
        {"trace": trace, "compare": compare, "pictures": pictures}[command](names)
