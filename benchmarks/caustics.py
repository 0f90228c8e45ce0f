# SPDX-License-Identifier: Apache-2.0
"""Caustics: accuracy, energy and time.

    python benchmarks/caustics.py [SECTION ...]

Sections: truth, energy, pareto, surface, stack, footprint, sizes, grids, short_waves, shadows, planes, speed, lookup,
animation, stress; without one, all of them. `truth` needs the folder of reference values beside the checkout;
elsewhere the finest grid of the exact method stands in. Times are medians after a warm-up: processor time of all
threads where OpenGL is a processor, which other work on the machine disturbs little, else time on the wall.
"""

from __future__ import annotations

import functools
import itertools
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.base.caustic_lookup import caustic_lookup, mip_level, mip_levels, periodic_trilinear
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.sphere import direction_from_angles
from mr360uw.caustics import (
    CausticSettings,
    GerstnerSea,
    SpectralSea,
    caustic_map,
    caustic_stack,
    stack_depths,
)
from mr360uw.caustics.irradiance import cell_flux, lit_corners, refracted_rays
from mr360uw.caustics.settings import PlaneLadder, grid_of
from mr360uw.caustics.summed_stack import summed_stack
from mr360uw.composite.gl.device import StackTextures
from mr360uw.errors import Mr360uwError
from mr360uw.gl import draw_fullscreen, gl_context, gl_device, program_from_text, set_uniforms
from mr360uw.types import CausticStack

ROOT = Path(__file__).resolve().parents[1]
TRUTH = Path(__file__).resolve().parents[2] / "shared" / "truth" / "caustics_truth.npz"
METHODS = ("exact", "ratio", "fan", "jacobian")
ZENITH = np.array([0.0, 1.0, 0.0])

CALM = [(1, 0, 0.03, 0.3, 1.0), (2, 1, 0.02, 1.7, 1.0), (0, -3, 0.012, 2.2, 1.0), (4, -3, 0.012, 4.0, 1.0),
        (6, 5, 0.006, 5.1, 1.0), (-3, 7, 0.004, 0.9, 1.0)]  # fmt: skip
CHOPPY = [(1, 0, 0.04, 0.3, 0.8), (2, 1, 0.03, 1.7, 0.8), (0, -3, 0.02, 2.2, 0.8), (4, -3, 0.02, 4.0, 0.8),
          (6, 5, 0.012, 5.1, 0.8), (-3, 7, 0.008, 0.9, 0.8), (9, -5, 0.006, 3.3, 0.8), (12, 7, 0.003, 2.6, 0.8),
          (-8, 14, 0.002, 1.2, 0.8), (19, 3, 0.0012, 5.9, 0.8)]  # fmt: skip
"""Waves (nx, nz, A, phase, Q) on the lattice of an 8 m tile."""


def sea_of(rows: list[tuple[float, ...]]) -> GerstnerSea:
    """Return a sea of the waves in a table."""
    w = np.array(rows)
    return GerstnerSea.from_waves(2.0 * np.pi / 8.0 * w[:, :2], w[:, 2], w[:, 4], w[:, 3], tile_m=8.0)


SHARP = GerstnerSea(detail_slope=0.0)
"""The default waves without the blur of others."""


def sun_at(zenith_deg: float, azimuth_rad: float = 0.6) -> np.ndarray:
    """Return the direction towards a sun."""
    return direction_from_angles(azimuth_rad, np.radians(90.0 - zenith_deg))


def rmse(got: np.ndarray, expected: np.ndarray) -> float:
    """Return the RMSE over the standard deviation of what is expected."""
    return float(np.sqrt(np.mean((got - expected) ** 2)) / np.std(expected))


def clock() -> Callable[[], float]:
    """Return the clock of the module's docstring."""
    return time.process_time if gl_device().software else time.perf_counter


def median_ms(work: Callable[[], object], repeats: int = 15) -> float:
    """Return the median time of some work."""
    times, now = [], clock()
    for i in range(repeats + 3):
        start = now()
        work()
        if i >= 3:
            times.append(now() - start)
    return 1e3 * statistics.median(times)


def cases() -> dict[str, tuple[GerstnerSea, np.ndarray, float, np.ndarray, str]]:
    """Sea, sun, depth, true map and its origin."""
    truth = np.load(TRUTH) if TRUTH.is_file() else None
    out = {}
    for name, rows, zenith, depth in (
        ("calm", CALM, 0.0, 3.0), ("choppy", CHOPPY, 0.0, 3.0), ("calm deep", CALM, 0.0, 9.0),
        ("choppy slanted", CHOPPY, 40.0, 5.0),
    ):  # fmt: skip
        sea, sun = sea_of(rows), sun_at(zenith)
        key = f"{name}_z0_d3"
        if truth is not None and key in truth:
            out[name] = (sea, sun, depth, truth[key].astype(float), "photons")
        else:
            fine = caustic_map(sea, sun, depth, 0.0, 512, 1536, sun_half_angle_rad=0.0)
            out[name] = (sea, sun, depth, fine, "grid 1536")
    return out


def truth() -> None:
    """Error against true maps."""
    if not TRUTH.is_file():
        print("the folder of reference values is not beside the checkout: the finest grid stands in")
    limits = {"calm": (None, 0.02), "calm deep": (None, 0.02), "choppy": (0.25, 0.05), "choppy slanted": (None, 0.08)}
    print(f"{'case':16}{'against':11}{'grid':>5}{'rmse/std':>10}{'limit':>7}{'mean - 1':>11}")
    for name, (sea, sun, depth, expected, origin) in cases().items():
        for grid, limit in zip((100, 256), limits[name], strict=True):
            got = caustic_map(sea, sun, depth, 0.0, 512, grid, sun_half_angle_rad=0.0)
            line = f"{name:16}{origin:11}{grid:5}{rmse(got, expected):10.4f}{limit or '-':>7}"
            print(f"{line}{got.mean() - 1:11.1e}")


def energy() -> None:
    """Energy at every depth and sun."""
    print("largest |mean - 1| over suns to 75 degrees from the zenith")
    print(f"{'sea':10}" + "".join(f"{d:>10} m" for d in (0, 1, 5, 15, 30)))
    seas = {"calm": sea_of(CALM), "choppy": sea_of(CHOPPY), "wind 10": GerstnerSea(wind_speed=10.0),
            "jonswap": SpectralSea(wind_speed=6.0)}  # fmt: skip
    for name, sea in seas.items():
        row = [
            max(abs(caustic_map(sea, sun_at(z), d, 0.2, 256, 128).mean() - 1.0) for z in (0.0, 30.0, 60.0, 75.0))
            for d in (0.0, 1.0, 5.0, 15.0, 30.0)
        ]
        print(f"{name:10}" + "".join(f"{v:12.1e}" for v in row))


def pareto() -> None:
    """Table of error over time; energy is the mean."""
    rows = []
    everything = cases()
    for method in METHODS:
        for size in (256, 512):
            for grid in (64, 128, 256, 512):
                errors, energies = {}, {}
                for name, (sea, sun, depth, expected, _) in everything.items():
                    true = expected.reshape(size, 512 // size, size, 512 // size).mean(axis=(1, 3))
                    got = caustic_map(sea, sun, depth, 0.0, size, grid, sun_half_angle_rad=0.0, method=method)
                    errors[name], energies[name] = rmse(got, true), float(got.mean())
                sea, sun, depth, *_ = everything["choppy"]
                rows.append((method, size, grid, errors, energies, _stack_ms(sea, sun, depth, size, grid, method)))
    print("time of the choppy sea, waves to mip levels; error / energy of each case")
    print(f"{'method':10}{'map':>5}{'grid':>5}{'ms':>8}" + "".join(f"{n:>24}" for n in everything))
    for method, size, grid, errors, energies, ms in rows:
        cells = "".join(f"{errors[n]:12.3f} /{energies[n]:10.4f}" for n in everything)
        print(f"{method:10}{size:5}{grid:5}{ms:8.1f}{cells}")
    for name in everything:
        front = _front([(r[5], r[3][name], f"{r[0]} {r[1]}/{r[2]}") for r in rows if r[1] == 512])
        print(f"front of {name} (map 512): " + ", ".join(label for _, _, label in front))


def _front(points: list[tuple[float, float, str]]) -> list[tuple[float, float, str]]:
    best: list[tuple[float, float, str]] = []
    for point in sorted(points):
        if not best or point[1] < best[-1][1]:
            best.append(point)
    return best


def _stack_ms(sea: GerstnerSea, sun: np.ndarray, depth: float, size: int, grid: int, method: str) -> float:
    """One plane from waves to mip levels."""
    return median_ms(lambda: _make(sea, sun, [depth], CausticSettings(size=size, grid=grid, method=method)))


def _make(sea: GerstnerSea, sun: np.ndarray, depths: Sequence[float], s: CausticSettings) -> None:
    stack = summed_stack(sea, sun, np.asarray(depths), 0.0, s, REFRACTIVE_INDEX_SEA, None)
    mip_levels(stack.ratio[..., :1])


def speed() -> None:
    """Times of stacks."""
    print("stacks between 3 and 5 m, default sea, sun's disc, waves to mip levels [ms]")
    for zenith, (size, grid) in itertools.product((30.0, 60.0), ((256, 128), (512, 128), (512, 256))):
        ms = []
        for planes in (1, 2, 3, 4):
            s, depths = CausticSettings(size=size, grid=grid), stack_depths(3.0, 5.0, planes)
            ms.append(median_ms(functools.partial(_make, GerstnerSea(), sun_at(zenith), depths, s), 9))
        print(f"  sun {zenith:.0f} deg, map {size}, grid {grid}, 1 to 4 planes:" + "".join(f"{t:7.1f}" for t in ms))


LOOKUP = """
#include "base/caustic_lookup.glsl"
uniform CausticStack stack;
uniform sampler2DArray ratio;
uniform sampler2D plane_depth;
in vec2 uv;
out vec4 seen;
void main() {
    vec3 point = vec3(20.0 * uv.x - 7.0, 1.5 + 7.0 * uv.y, 13.0 * uv.y + 2.0 * uv.x);
    float footprint_m = 0.01 + 0.25 * uv.x * uv.y;
    seen = vec4(CALL, 1.0);
}
"""


def lookup() -> None:
    """Time of a lookup: a slanted plane over 2048 x 512 pixels, less a pass without lookups."""
    print(f"OpenGL: {gl_device().renderer}; nanoseconds for a pixel")
    calls = {True: "caustic_lookup(stack, ratio, plane_depth, point, footprint_m)", False: "point * footprint_m"}
    shaders = {reads: program_from_text(fragment=LOOKUP.replace("CALL", call)) for reads, call in calls.items()}
    context = gl_context()
    target = context.framebuffer([context.texture((2048, 512), 4, dtype="f4")])
    rng = np.random.default_rng(0)
    for colours, planes in itertools.product((1, 3), (1, 2, 4, 8)):
        ratio = np.broadcast_to(rng.uniform(0.5, 2.0, (planes, 256, 256, colours)), (planes, 256, 256, 3))
        light = CausticStack(ratio, stack_depths(2.0, 8.0, planes), 8.0, np.array([0.2, 0.93, -0.3]))
        textures = StackTextures().of(light)
        times = {}
        for reads, shader in shaders.items():
            for unit, (name, texture) in enumerate(textures.items()):
                texture.use(unit)
                set_uniforms(shader, **{name.removeprefix("caustic_"): unit})
            set_uniforms(shader, stack__tile_m=light.tile_m, stack__sun_direction=light.sun_direction)

            def once(shader: Any = shader) -> None:
                draw_fullscreen(target, shader)
                context.finish()

            times[reads] = median_ms(once) * 1e6 / (2048 * 512)
        print(f"  {planes} planes, {colours} colours: {times[True] - times[False]:6.1f}")


def surface() -> None:
    """Normals, Jacobians, transforms, heights, edges and loops."""
    step, rng = 1e-5, np.random.default_rng(1)
    x, z = rng.uniform(0.0, 8.0, (2, 400))
    titles = ("normal", "jacobian", "least J", "fft-sum", "4 std/Hs", "edge", "loop")
    print(f"{'sea':12}" + "".join(f"{t:>10}" for t in titles))
    spectra = ("phillips", "jonswap", "tma")
    seas: dict[str, GerstnerSea | SpectralSea] = {
        "gerstner": GerstnerSea(loop_s=5.0),
        "steep": GerstnerSea(loop_s=5.0, wind_speed=25.0, steepness=1.0),
    }
    seas |= {n: SpectralSea(spectrum=n, resolution=64, loop_s=5.0, wind_speed=6.0, water_depth_m=3.0) for n in spectra}
    for name, sea in seas.items():
        s = sea.surface(x, z, 0.8)
        tx, tz = (
            (sea.surface(x + a, z + b, 0.8).position - sea.surface(x - a, z - b, 0.8).position) / (2.0 * step)
            for a, b in ((step, 0.0), (0.0, step))
        )
        n = np.cross(tz, tx)
        normal = np.abs(s.normal - n / np.linalg.norm(n, axis=1, keepdims=True)).max()
        jacobian = np.abs(s.jacobian - (tx[:, 0] * tz[:, 2] - tx[:, 2] * tz[:, 0])).max()
        grid = sea.grid_surface(64, 0.8)
        at = np.arange(64) * (sea.tile_m / 64)
        direct = sea.surface(*np.meshgrid(at, at), 0.8)
        difference = np.abs(grid.position - direct.position).max()
        height = (
            4.0 * grid.position[..., 1].std() / sea.significant_height_m if isinstance(sea, SpectralSea) else np.nan
        )
        edge = np.abs(sea.surface(0.0, at, 0.8).normal - sea.surface(sea.tile_m, at, 0.8).normal).max()
        loop = np.abs(sea.grid_surface(64, 0.0).position - sea.grid_surface(64, 5.0).position).max()
        print(f"{name:12}{normal:10.1e}{jacobian:10.1e}{grid.jacobian.min():10.3f}{difference:10.1e}", end="")
        print(f"{height:10.4f}{edge:10.1e}{loop:10.1e}")


def stack() -> None:
    """The mix of two planes at the middle depth, the worst interval.

    Against a plane right there, read in the same way at random places: what the mix is wrong by. Against the map there
    on the world's grid, at its pixels' centres: what reading a map at another part of its pixels adds.
    """
    print(
        "rmse/std between the planes, worst interval (map 256, grid 256): against a plane there / the map on the grid"
    )
    x, z = np.random.default_rng(1).uniform(0.0, 8.0, (2, 40_000))
    columns, rows = np.meshgrid(*((np.arange(256) + 0.5) * 8.0 / 256,) * 2)
    for name, waves in (("calm", CALM), ("choppy", CHOPPY)):
        sea = sea_of(waves)
        for near, far, count in ((2.0, 10.0, 8), (4.0, 8.0, 8), (4.0, 8.0, 16), (4.0, 8.0, 32)):
            line = f"  {name:8} {near:4.0f} to {far:4.0f} m, {count:2} planes:"
            for zenith in (0.0, 11.0, 40.0):
                s, sun = CausticSettings(size=256, grid=256), sun_at(zenith)
                depths = stack_depths(near, far, count)
                planes = caustic_stack(sea, sun, depths, 0.0, s)
                levels = mip_levels(planes.ratio)
                worst = [0.0, 0.0]
                for i in range(0, count - 1, max(count // 8, 1)):
                    depth = 0.5 * (depths[i] + depths[i + 1])
                    there = caustic_stack(sea, sun, [depth], 0.0, s)
                    direct = caustic_lookup(there, mip_levels(there.ratio), x, depth, z, 0.0)
                    between = caustic_lookup(planes, levels, x, depth, z, 0.0)
                    worst[0] = max(worst[0], rmse(between, direct))
                    on_grid = caustic_map(sea, sun, depth, 0.0, 256, 256)
                    between = caustic_lookup(planes, levels, columns, depth, rows, 0.0)[..., 0]
                    worst[1] = max(worst[1], rmse(between, on_grid))
                line += f"   sun {zenith:2.0f} deg {worst[0]:.3f} / {worst[1]:.3f}"
            print(line)


def _mean_over(fine: np.ndarray, width: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return means of a periodic map over squares of `width` (even) of its pixels about places in tiles."""
    from scipy.ndimage import uniform_filter

    half = 0.5 / fine.shape[0]  # an even square lies about a pixel's corner
    mean = uniform_filter(fine, width, mode="wrap")[None, :, :, None] * np.ones(3)
    return periodic_trilinear([mean], np.zeros(u.shape, np.int64), u + half, v + half, np.zeros(u.shape))[..., 0]


def footprint() -> None:
    """Lookups against the mean over their footprint: by the level of equal variance, and by that of equal width."""
    print(
        "contrast and rmse/std against the mean over the footprint (map 256): level of equal variance | of equal width"
    )
    u, v = np.random.default_rng(1).uniform(0.0, 1.0, (2, 40_000))
    plane = np.zeros(u.shape, np.int64)
    for name, sea in (("default", SHARP), ("choppy", sea_of(CHOPPY))):
        fine, coarse = (
            caustic_stack(sea, ZENITH, [4.0], 0.0, CausticSettings(size=n, grid=512)).ratio for n in (2048, 256)
        )
        levels = mip_levels(coarse)
        for across in (1.0, 1.5, 2.0, 3.0, 4.0, 6.0):
            mean = _mean_over(fine[0, :, :, 0], round(8 * across), u, v)
            line = f"  {name:8} footprint {across:3.1f} pixels:"
            for wide in (1.0, 3.0**0.5):
                level = mip_level(np.full(u.shape, across * wide), 1.0, 8.0)
                seen = periodic_trilinear(levels, plane, u, v, level)[..., 0]
                line += f"   {seen.std() / mean.std():.2f} {rmse(seen, mean):.3f}"
            print(line)


def sizes() -> None:
    """Error of maps and grids of all sizes in what a picture shows."""
    print("rmse/std and contrast against the mean over a pixel's footprint in a map 2048 from a grid 1024")
    u, v = np.random.default_rng(1).uniform(0.0, 1.0, (2, 40_000))
    plane = np.zeros(u.shape, np.int64)
    for name, sea, zenith, depth in (("default", SHARP, 30.0, 4.0), ("choppy", sea_of(CHOPPY), 0.0, 5.0)):
        sun = sun_at(zenith)
        fine = caustic_stack(sea, sun, [depth], 0.0, CausticSettings(size=2048, grid=1024)).ratio[0, :, :, 0]
        for size, grid in (
            (128, 128),
            (256, 64),
            (256, 128),
            (256, 192),
            (256, 256),
            (512, 128),
            (512, 192),
            (512, 256),
        ):
            s = CausticSettings(size=size, grid=grid)
            levels = mip_levels(caustic_stack(sea, sun, [depth], 0.0, s).ratio)
            ms = median_ms(functools.partial(caustic_stack, sea, sun, [depth], 0.0, s), 7)
            line = f"  {name:8} map {size}, grid {grid}: {ms:5.1f} ms"
            for width_m in (0.0078, 0.031, 0.0625):
                mean = _mean_over(fine, round(width_m * 2048 / 8.0), u, v)
                level = mip_level(np.full(u.shape, width_m), 8.0 / size, float(len(levels) - 1))
                seen = periodic_trilinear(levels, plane, u, v, level)[..., 0]
                line += f"   {100 * width_m:.1f} cm {rmse(seen, mean):.3f} {seen.std() / mean.std():.2f}"
            print(line)


def grids() -> None:
    """Error of grids against a grid of 1024, and the grid that is chosen; sun overhead."""
    choppy, counts = sea_of(CHOPPY), (96, 128, 160, 192, 256)
    seas = {"default": GerstnerSea(), "default waves": SHARP, "choppy": choppy, "jonswap": SpectralSea()}
    seas |= {f"choppy + {s}": choppy.model_copy(update={"detail_slope": s}) for s in (0.05, 0.1)}
    for name, sea in seas.items():
        for depth in (3.0, 9.0):
            fine = caustic_map(sea, ZENITH, depth, 0.0, 512, 1024)
            errors = (f"{g}: {rmse(caustic_map(sea, ZENITH, depth, 0.0, 512, g), fine):.3f}" for g in counts)
            print(f"  {name:14} {depth:.0f} m, chosen {grid_of(CausticSettings(), sea)}   {'   '.join(errors)}")


def short_waves() -> None:
    """The blur against 300 waves from 0.2 m down to 17 mm that are drawn, wind 4 m/s: a minute."""
    sea, rng, count = GerstnerSea(), np.random.default_rng(3), 300
    longest, shortest = 2.0 * np.pi / 0.2, 370.0
    slope = sea.detail_rms_slope**2
    length = longest * (shortest / longest) ** ((np.arange(count) + rng.uniform(0.0, 1.0, count)) / count)
    turn = np.radians(55.0) * rng.standard_normal(count) + np.arctan2(sea.wind_travel[1], sea.wind_travel[0])
    k = np.round(length[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1) * 8.0 / (2.0 * np.pi))
    k *= 2.0 * np.pi / 8.0
    w, amplitude = sea.waves, np.sqrt(2.0 * slope / count) / np.linalg.norm(k, axis=1)
    drawn = GerstnerSea.from_waves(
        np.concatenate([w.wave_vector, k]), np.concatenate([w.amplitude_m, amplitude]),
        np.concatenate([w.steepness, np.zeros(count)]), np.concatenate([w.phase_rad, rng.uniform(0.0, 6.28, count)]),
    )  # fmt: skip
    for depth in (1.0, 3.0, 8.0, 15.0):
        true = caustic_map(drawn, sun_at(30.0), depth, 0.0, 256, 2048)
        line = f"  {depth:2.0f} m, 3 cm wide: correlation and std over the true ones:"
        for name, model in (("sharp", SHARP), ("blurred", sea)):
            got = caustic_map(model, sun_at(30.0), depth, 0.0, 256, 512)
            line += f"   {name} {np.corrcoef(got.ravel(), true.ravel())[0, 1]:.2f} {got.std() / true.std():.2f}"
        print(line)


def shadows() -> None:
    """Light that low suns' waves take in, over what comes in, and the time of finding the shadows."""
    for wind, elevation, grid in itertools.product((5.0, 10.0), (5.0, 10.0, 20.0), (128, 192, 256)):
        sun, surface = sun_at(90.0 - elevation), GerstnerSea(wind_speed=wind).grid_surface(grid, 0.0)
        through = refracted_rays(surface, sun, 1.34)[2]
        met, passed = (
            cell_flux(surface, t, sun, 8.0).sum() / (64.0 * sun[1]) for t in (np.ones_like(through), through)
        )
        ms = median_ms(functools.partial(lit_corners, surface, sun, 8.0), 5)
        print(
            f"  {wind:2.0f} m/s, {elevation:2.0f} deg, grid {grid}: in {met:.3f}, passed on {passed:.3f}, {ms:.0f} ms"
        )


def planes() -> None:
    """A body 1 m tall rises past another one: the change of the other's light from frame to frame, the sea at rest."""
    x, z = np.random.default_rng(0).uniform(0.0, 8.0, (2, 4000))
    sea, sun, s = SHARP, sun_at(30.0), CausticSettings(size=256, grid=128)
    ladder = PlaneLadder.of_scene([(4.0, 7.0), (5.5, 6.5)], [1.0, 1.0], [], s.planes)
    seen, counts = [], []
    for middle in np.linspace(6.5, 4.5, 25):
        depths = ladder.around([(middle - 0.5, middle + 0.5), (5.5, 6.5)])
        stack = caustic_stack(sea, sun, depths, 0.0, s)
        seen.append(caustic_lookup(stack, mip_levels(stack.ratio), x, 6.0, z, 0.03))
        counts.append(len(depths))
    steps = [rmse(b, a) for a, b in itertools.pairwise(seen)]
    print(f"largest rmse/std from frame to frame {max(steps):.1e}; planes {min(counts)} to {max(counts)}")


def animation() -> None:
    """A loop of the default sea: the change from frame to frame, and that of a frame by itself."""
    sea, frames, loop = GerstnerSea(loop_s=4.0), 96, 4.0
    maps = [caustic_map(sea, sun_at(30.0), 4.0, loop * i / frames, 256, 128) for i in range(frames + 1)]
    steps = [rmse(b, a) for a, b in itertools.pairwise(maps)]
    print(
        f"24 frames a second: rmse/std from frame to frame {min(steps):.3f} to {max(steps):.3f}, "
        f"median {statistics.median(steps):.3f}"
    )
    print(f"first and last frame of the loop: {rmse(maps[-1], maps[0]):.1e}")


def stress() -> None:
    """Extremes: finite, or a typed error."""
    choppy = sea_of(CHOPPY)
    runs: list[tuple[str, GerstnerSea | SpectralSea, dict]] = [
        ("zero wind", GerstnerSea(wind_speed=0.0), {}), ("one wave", GerstnerSea(wave_count=1), {}),
        ("steepness 1", GerstnerSea(steepness=1.0, wind_speed=40.0), {}),
        ("sun on the horizon", choppy, {"sun": (1.0, 0.0, 0.0)}),
        ("sun 0.06 deg up", choppy, {"sun": (1.0, 1e-3, 0.0)}),
        ("depth 0", choppy, {"depth": 0.0}), ("depth 1e-6", choppy, {"depth": 1e-6}),
        ("depth 200", choppy, {"depth": 200.0}), ("tile 0.1", GerstnerSea(tile_m=0.1), {}),
        ("tile 1000", GerstnerSea(tile_m=1000.0), {}), ("size 16", choppy, {"size": 16}),
        ("size 4096", choppy, {"size": 4096}), ("NaN depth", choppy, {"depth": np.nan}),
        ("NaN time", choppy, {"t": np.nan}),
    ]  # fmt: skip
    for label, sea, a in runs:
        start = time.perf_counter()
        try:
            ratio = caustic_map(sea, a.get("sun", ZENITH), a.get("depth", 3.0), a.get("t", 0.0), a.get("size", 256), 64)
            said = f"finite {bool(np.all(np.isfinite(ratio)))}, mean - 1 = {ratio.mean(dtype=float) - 1:.1e}"
        except Mr360uwError as error:
            said = f"{type(error).__name__}: {error}"
        print(f"{label:20}{1e3 * (time.perf_counter() - start):8.0f} ms  {said}")


_ALL = (
    truth,
    energy,
    pareto,
    surface,
    stack,
    footprint,
    sizes,
    grids,
    short_waves,
    shadows,
    planes,
    speed,
    lookup,
    animation,
    stress,
)
SECTIONS = {f.__name__: f for f in _ALL}


def main() -> None:
    """Run the sections that are asked for."""
    wanted = sys.argv[1:] or list(SECTIONS)
    for name in wanted:
        if name not in SECTIONS:
            sys.exit(f"{name} - no such section - choose from {', '.join(SECTIONS)}")
        print(f"--- {name}")
        SECTIONS[name]()


if __name__ == "__main__":
    main()
