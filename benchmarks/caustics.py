# SPDX-License-Identifier: Apache-2.0
"""Caustics: accuracy, energy, time and pictures.

    python benchmarks/caustics.py [truth | energy | pareto | surface | stack | speed | sheet | animation | stress]

Without a section, all of them. `truth` needs the folder of reference values beside the checkout; elsewhere the finest
grid of the exact method stands in. Times are medians after a warm-up, in milliseconds.
"""

from __future__ import annotations

import itertools
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mr360uw.caustics import (
    CausticSettings,
    GerstnerSea,
    SpectralSea,
    caustic_map,
    caustic_stack,
    stack_depths,
)
from mr360uw.caustics.gl import caustic_renderer
from mr360uw.caustics.lookup import caustic_lookup, mip_levels
from mr360uw.errors import Mr360uwError
from mr360uw.gl.context import gl_context, gl_device
from mr360uw.sphere import direction_from_angles

ROOT = Path(__file__).resolve().parents[1]
TRUTH = Path(__file__).resolve().parents[2] / "shared" / "truth" / "caustics_truth.npz"
DOCS = ROOT / "docs"
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


def sun_at(zenith_deg: float, azimuth_rad: float = 0.6) -> np.ndarray:
    """Return the direction towards a sun."""
    return direction_from_angles(azimuth_rad, np.radians(90.0 - zenith_deg))


def rmse(got: np.ndarray, expected: np.ndarray) -> float:
    """Return the RMSE over the standard deviation of what is expected."""
    return float(np.sqrt(np.mean((got - expected) ** 2)) / np.std(expected))


def median_ms(work: Callable[[], object], repeats: int = 15) -> float:
    """Return the median time of some work."""
    times = []
    for i in range(repeats + 3):
        start = time.perf_counter()
        work()
        if i >= 3:
            times.append(time.perf_counter() - start)
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
    print(f"{'case':16}{'against':11}{'renderer':11}{'grid':>5}{'rmse/std':>10}{'limit':>7}{'mean - 1':>11}")
    for name, (sea, sun, depth, expected, origin) in cases().items():
        for backend in ("reference", "gl"):
            for grid, limit in zip((100, 256), limits[name], strict=True):
                got = caustic_map(sea, sun, depth, 0.0, 512, grid, sun_half_angle_rad=0.0, backend=backend)
                line = f"{name:16}{origin:11}{backend:11}{grid:5}{rmse(got, expected):10.4f}{limit or '-':>7}"
                print(f"{line}{got.mean() - 1:11.1e}")


def energy() -> None:
    """Energy at every depth and sun."""
    print("largest |mean - 1| over suns to 75 degrees from the zenith")
    print(f"{'sea':10}{'renderer':11}" + "".join(f"{d:>10} m" for d in (0, 1, 5, 15, 30)))
    seas = {"calm": sea_of(CALM), "choppy": sea_of(CHOPPY), "wind 10": GerstnerSea(wind_speed=10.0),
            "jonswap": SpectralSea(wind_speed=6.0)}  # fmt: skip
    for name, sea in seas.items():
        for backend in ("reference", "gl"):
            row = [
                max(
                    abs(caustic_map(sea, sun_at(z), d, 0.2, 256, 128, backend=backend).mean() - 1.0)
                    for z in (0.0, 30.0, 60.0, 75.0)
                )
                for d in (0.0, 1.0, 5.0, 15.0, 30.0)
            ]
            print(f"{name:10}{backend:11}" + "".join(f"{v:12.1e}" for v in row))


def pareto() -> None:
    """Table and plot of error over time; energy is the mean."""
    device = gl_device().renderer
    rows = []
    everything = cases()
    for method in METHODS:
        for size in (256, 512):
            for grid in (64, 128, 256, 512):
                errors, energies, times = {}, {}, {}
                for name, (sea, sun, depth, expected, _) in everything.items():
                    true = expected.reshape(size, 512 // size, size, 512 // size).mean(axis=(1, 3))
                    got = caustic_map(
                        sea, sun, depth, 0.0, size, grid, sun_half_angle_rad=0.0, method=method, backend="gl"
                    )
                    errors[name], energies[name] = rmse(got, true), float(got.mean())
                sea, sun, depth, *_ = everything["choppy"]
                times["gl"] = _stack_ms(sea, sun, depth, size, grid, method)
                times["numba"] = _map_ms(sea, sun, depth, size, grid, method)
                rows.append((method, size, grid, errors, energies, times))
    print(f"OpenGL: {device}; time of the choppy sea; energy and error of each case")
    print(f"{'method':10}{'map':>5}{'grid':>5}{'gl ms':>8}{'cpu ms':>8}" + "".join(f"{n:>24}" for n in everything))
    for method, size, grid, errors, energies, times in rows:
        cells = "".join(f"{errors[n]:12.3f} /{energies[n]:10.4f}" for n in everything)
        print(f"{method:10}{size:5}{grid:5}{times['gl']:8.1f}{times['numba']:8.1f}{cells}")
    for name in everything:
        front = _front([(r[5]["gl"], r[3][name], f"{r[0]} {r[1]}/{r[2]}") for r in rows if r[1] == 512])
        print(f"front of {name} (map 512): " + ", ".join(label for _, _, label in front))
    _plot_pareto(rows, list(everything), device)


def _front(points: list[tuple[float, float, str]]) -> list[tuple[float, float, str]]:
    best: list[tuple[float, float, str]] = []
    for point in sorted(points):
        if not best or point[1] < best[-1][1]:
            best.append(point)
    return best


def _plot_pareto(rows: list[tuple], names: list[str], device: str) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    figure, axes = plt.subplots(1, len(names), figsize=(4.2 * len(names), 4.2), sharex=True)
    for axis, name in zip(axes, names, strict=True):
        for method in METHODS:
            points = [(r[5]["gl"], r[3][name], r[2]) for r in rows if r[0] == method and r[1] == 512]
            axis.plot(
                [p[0] for p in points], [p[1] for p in points], "o-", label=method, lw=2.5 if method == "exact" else 1
            )
            for x, y, grid in points:
                axis.annotate(str(grid), (x, y), fontsize=7, xytext=(3, 3), textcoords="offset points")
        axis.set(xscale="log", yscale="log", title=name, xlabel="ms")
        axis.grid(alpha=0.3, which="both")
        axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("RMSE / standard deviation")
    axes[-1].legend()
    figure.suptitle(f"Caustic map 512 x 512, numbers: grid; {device}", fontsize=10)
    figure.tight_layout()
    DOCS.mkdir(exist_ok=True)
    figure.savefig(DOCS / "caustics-pareto.png", dpi=110)
    print(f"wrote {DOCS / 'caustics-pareto.png'}")


def _stack_ms(
    sea: GerstnerSea, sun: np.ndarray, depth: float, size: int, grid: int, method: str = "exact", disc: float = 0.0
) -> float:
    """One plane from waves to mip levels, nothing read back."""
    settings = CausticSettings(size=size, grid=grid, method=method, sun_half_angle_rad=disc)
    context, renderer = gl_context(), caustic_renderer()

    def once() -> None:
        renderer.stack(sea, sun, [depth], 0.0, settings)
        context.finish()

    return median_ms(once)


def _map_ms(sea: GerstnerSea, sun: np.ndarray, depth: float, size: int, grid: int, method: str) -> float:
    """One map by the reference."""
    return median_ms(lambda: caustic_map(sea, sun, depth, 0.0, size, grid, sun_half_angle_rad=0.0, method=method), 5)


def speed() -> None:
    """Times of single planes and of the default stack."""
    print(f"OpenGL: {gl_device().renderer}")
    choppy, default = sea_of(CHOPPY), GerstnerSea()
    print("one plane, waves to mip levels, without reading back [ms]")
    for label, sea in (("10 waves", choppy), (f"{default.wave_count} waves", default)):
        for size, grid in ((256, 128), (512, 256)):
            exact, ratio = (_stack_ms(sea, ZENITH, 3.0, size, grid, m) for m in ("exact", "ratio"))
            print(
                f"  {label:9} {size}/{grid}: exact {exact:6.1f}   ratio {ratio:6.1f}   exact/ratio {exact / ratio:.2f}"
            )
    renderer, context = caustic_renderer(), gl_context()
    for planes in (1, 2, 3, 4):
        s = CausticSettings(planes=planes)
        depths = stack_depths(2.0, 8.0, planes)

        def once(s: CausticSettings = s, depths: np.ndarray = depths) -> None:
            renderer.stack(default, sun_at(30.0), depths, 0.0, s)
            context.finish()

        print(f"default settings (256/128, sun's disc), {planes} planes from 2 to 8 m: {median_ms(once):6.1f} ms")


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
    """The mix of two planes at the middle depth against the map there: the worst interval."""
    print("rmse/std between the planes, worst interval (map 256, grid 256)")
    for name, rows in (("calm", CALM), ("choppy", CHOPPY)):
        sea = sea_of(rows)
        for near, far, count in ((2.0, 10.0, 8), (4.0, 8.0, 8), (4.0, 8.0, 16), (4.0, 8.0, 32)):
            line = f"  {name:8} {near:4.0f} to {far:4.0f} m, {count:2} planes:"
            for zenith in (0.0, 11.0, 40.0):
                s = CausticSettings(size=256, grid=256)
                depths = stack_depths(near, far, count)
                planes = caustic_stack(sea, sun_at(zenith), depths, 0.0, s)
                levels = mip_levels(planes.ratio)
                x, z = np.meshgrid(*((np.arange(256) + 0.5) * 8.0 / 256,) * 2)
                worst = 0.0
                for i in range(0, count - 1, max(count // 8, 1)):
                    depth = 0.5 * (depths[i] + depths[i + 1])
                    direct = caustic_stack(sea, sun_at(zenith), [depth], 0.0, s).ratio[0]
                    between = caustic_lookup(planes, levels, x, np.full_like(x, depth), z, np.zeros_like(x))
                    worst = max(worst, rmse(between, direct))
                line += f"   sun {zenith:2.0f} deg {worst:.3f}"
            print(line)


def sheet() -> None:
    """Calm to rough, 1 to 20 m, sun 0 to 60 degrees from the zenith: docs/caustics-sheet.png."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    winds, depths, zeniths = (1.5, 4.0, 10.0), (1.0, 3.0, 8.0, 20.0), (0.0, 30.0, 60.0)
    figure, axes = plt.subplots(len(winds) * len(zeniths), len(depths), figsize=(10.5, 24.0))
    for i, wind in enumerate(winds):
        for j, zenith in enumerate(zeniths):
            for k, depth in enumerate(depths):
                ratio = caustic_map(GerstnerSea(wind_speed=wind), sun_at(zenith), depth, 0.0, 256, 256)
                axis = axes[i * len(zeniths) + j, k]
                axis.imshow((np.clip(ratio, 0.0, 4.0) / 4.0) ** (1 / 2.2), cmap="gray", vmin=0.0, vmax=1.0)
                axis.set_title(f"{wind:g} m/s, {depth:g} m, sun {zenith:g}°, std {ratio.std():.2f}", fontsize=7)
                axis.axis("off")
    figure.tight_layout()
    DOCS.mkdir(exist_ok=True)
    figure.savefig(DOCS / "caustics-sheet.png", dpi=80)
    print(f"wrote {DOCS / 'caustics-sheet.png'}")


def animation() -> None:
    """A loop of the default sea: the change from frame to frame, and that of a frame by itself."""
    sea, frames, loop = GerstnerSea(loop_s=4.0), 96, 4.0
    maps = [caustic_map(sea, sun_at(30.0), 4.0, loop * i / frames, 256, 128, backend="gl") for i in range(frames + 1)]
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
        for backend in ("reference", "gl"):
            start = time.perf_counter()
            try:
                ratio = caustic_map(
                    sea,
                    a.get("sun", ZENITH),
                    a.get("depth", 3.0),
                    a.get("t", 0.0),
                    a.get("size", 256),
                    64,
                    backend=backend,
                )
                said = f"finite {bool(np.all(np.isfinite(ratio)))}, mean - 1 = {ratio.mean(dtype=float) - 1:.1e}"
            except Mr360uwError as error:
                said = f"{type(error).__name__}: {error}"
            print(f"{label:20}{backend:11}{1e3 * (time.perf_counter() - start):8.0f} ms  {said}")


SECTIONS = {f.__name__: f for f in (truth, energy, pareto, surface, stack, speed, sheet, animation, stress)}


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
