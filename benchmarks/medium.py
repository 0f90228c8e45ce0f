# SPDX-License-Identifier: Apache-2.0
"""How right and how fast the water is: python benchmarks/medium.py [section ...], all of them without arguments.

closed-form, field, pictures: against reference values and path-traced pictures of the folder `shared` beside the
checkout. models: the published formulas against exact transfer over all cameras. bands: error of n wavelengths by three
rules. objects: coloured objects seen through effective transmittances. cost, tables: time and error of lookups. gain,
names: gain of the veil and type of the water, read from synthetic dives. store-bands: makes
mr360uw/medium/data/fitted_bands.json (minutes).
"""

from __future__ import annotations

import csv
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from mr360uw.base.color import decode, encode, rgb_from_ycbcr  # noqa: E402
from mr360uw.medium import (  # noqa: E402
    JERLOV_TYPES,
    LightField,
    Medium,
    Sensor,
    Water,
    bands,
    cameras,
    compress_gamut,
    multiple_scattering,
    reflectance,
    spectral_model,
)
from mr360uw.medium.closed_form import closed_form, ray_in_water  # noqa: E402
from mr360uw.medium.lookup import transmittance_lookup, veil_lookup  # noqa: E402
from tests.medium.picture import Scene, relative_rms, render  # noqa: E402

SHARED = Path(__file__).resolve().parents[2] / "shared"
DEPTHS = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0)
STREAMS = 64
"""Directions a hemisphere of the exact field, four times as many as the renderers solve."""
RULES = ("rectangle", "integrated", "fitted")


def truth(name: str) -> Path:
    """Return a file of reference values; leave with a message where there is none."""
    path = SHARED / "truth" / name
    if not path.exists():
        raise SystemExit(f"{path} - this section needs the reference values (got no such file) - put them there")
    return path


def rms(x: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def median_time(call: Callable[[], object], repeats: int = 7) -> float:
    """Return the median wall time [s] of a call."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def section_closed_form() -> None:
    """The published closed form, made stable, against 50-digit arithmetic."""
    with truth("golden_closed_form.csv").open() as file:
        rows = np.array([[float(x) for x in row[1:]] for row in list(csv.reader(file))[1:]])
    b, c, k, y, mu, s, expected = rows.T
    lit = expected > 0.0
    print("largest relative error against 50-digit arithmetic (45 rows)")
    print(f"  float64     {np.max(np.abs(closed_form(b, c, k, s, y, mu)[lit] / expected[lit] - 1)):.1e}")
    rng = np.random.default_rng(0)
    n = 1_000_000
    b, a = 10.0 ** rng.uniform(-4, 1, n), 10.0 ** rng.uniform(-4, 1, n)
    got = closed_form(
        b,
        a + b,
        a * rng.uniform(1, 4, n),
        10.0 ** rng.uniform(-9, 12, n),
        10.0 ** rng.uniform(-6, 4, n),
        rng.uniform(-1, 1, n),
    )
    print(f"  a million random cases: {np.sum(~np.isfinite(got))} not finite, {np.sum(got < 0)} negative")


def section_field() -> None:
    """The solved light field against exact transfer, and the published form beside it."""
    with truth("golden_rte.csv").open() as file:
        rows = list(csv.DictReader(file))
    settings = {
        "iso_null": ("isotropic", "none"), "iso_snell": ("isotropic", "snell"), "hg924_null": (("hg", 0.924), "none"),
        "hg924_snell": (("hg", 0.924), "snell"), "petz_snell": ("petzold", "snell"),
    }  # fmt: skip
    print("setting       rms in-scatter   largest   rms kd    E_d      E_u      E_o      E_h      ms/wavelength")
    for name, (phase, surface) in settings.items():
        mine = [row for row in rows if row["setting"] == name]
        v = {
            key: np.array([float(row[key]) for row in mine])
            for key in mine[0]
            if key.endswith(("_m", "_down", "L_medium")) or key[0] in "EL"
        }
        a, b, y, mu = v["a_per_m"], v["b_per_m"], v["depth_m"], v["mu_travel_down"]
        field = LightField(a, b, phase, surface)
        seconds = median_time(lambda a=a, b=b, phase=phase, surface=surface: LightField(a, b, phase, surface)) / len(a)
        error = (np.diagonal(field.inscatter(v["ray_length_m"], y, mu)) - v["L_medium"]) / v["L_total_at_camera"]
        kd = np.array([float(row["Kd_table_per_m"]) for row in mine])
        published = (closed_form(b, a + b, kd, v["ray_length_m"], y, mu) - v["L_medium"]) / v["L_total_at_camera"]
        light = [
            np.max(np.abs(np.diagonal(e) / v[key] - 1))
            for e, key in (
                (field.irradiance(y, 1.0), "E_d"), (field.irradiance(y, -1.0), "E_u"),
                (field.scalar_irradiance(y), "E_o"), (field.irradiance(y, 0.0), "E_vertical_plane"),
            )
        ]  # fmt: skip
        print(
            f"{name:12s}  {rms(error):.5f}          {np.abs(error).max():.4f}    {rms(published):.3f}     "
            + "  ".join(f"{x:.1e}" for x in light)
            + f"  {1e3 * seconds:.2f}"
        )


def section_pictures() -> None:
    """Whole pictures against path tracing."""
    data = np.load(truth("mitsuba_scene.npz"))
    scene = Scene.of(data["spheres"], *data["mixed"].shape)
    a, b, kd = data["iop"][0].T
    w = data["wl"]
    print("path-traced picture          relative rms over wavelengths and pixels (noise 0.025)")
    for name, phase in (("L_II_hg924", ("hg", 0.924)), ("L_II_iso", "isotropic")):
        picture = np.moveaxis(data[name], 0, -1)
        water = Water.from_arrays(w, a, b, kd, phase)
        cells = []
        for mode in ("kd", "kd+", "table"):
            model = spectral_model(water, w, mode, surface="none")
            cells.append(f"{mode} {relative_rms(render(scene, model), picture, scene):.3f}")
        model = spectral_model(water, w, "table", surface="none")
        flat = Scene(**{**scene.__dict__, "normal_up": np.ones_like(scene.normal_up)})
        cells.append(f"table without E(normal) {relative_rms(render(flat, model), picture, scene):.3f}")
        per_pixel = (render(scene, model) / picture - 1.0)[scene.valid]
        cells.append(f"table, rms of each pixel's own ratio {rms(per_pixel):.3f}")
        # three wavelengths carry the colour: their neighbours stand for the rest
        few = np.interp(w, [450.0, 550.0, 650.0], [0, 1, 2]).round().astype(int)
        source = np.array([0, 2, 4])[few]
        rgb = render(scene, spectral_model(water, w, "kd", surface="none"))[..., source]
        cells.append(f"rgb {relative_rms(rgb, picture, scene):.3f}")
        print(f"  {name:12s} " + "   ".join(cells))


def _hsv_cone(rgb: np.ndarray) -> np.ndarray:
    from matplotlib.colors import rgb_to_hsv

    h, s, v = np.moveaxis(rgb_to_hsv(np.clip(rgb, 0.0, 1.0)), -1, 0)
    return np.stack([s * v * np.cos(2 * np.pi * h), s * v * np.sin(2 * np.pi * h), v], axis=-1)


def section_models() -> None:
    """The veil of endless rays below Snell's window, all cameras and waters, against 64-stream transfer."""
    up = np.linspace(-1.0, 0.6, 33)
    w = bands(61).wavelength_nm
    sensors = [bands(61, Sensor.camera(name)).weight for name in cameras()]
    kinds = ("rgb", "kd", "kd+", "table")
    relative = {kind: np.zeros((len(JERLOV_TYPES), len(DEPTHS))) for kind in kinds}
    hsv = {kind: np.zeros((len(JERLOV_TYPES), len(DEPTHS))) for kind in kinds}
    exposed = {kind: [] for kind in kinds}
    for i, name in enumerate(JERLOV_TYPES):
        water = Water.jerlov(name)
        moments = water.moments(w, 2 * STREAMS + 1)
        exact_field = LightField(water.absorption(w), water.scattering(w), moments, streams=STREAMS)
        models = {kind: spectral_model(water, w, kind) for kind in ("kd", "kd+", "table")}
        three = spectral_model(water, [650.0, 550.0, 450.0], "kd")
        for j, depth in enumerate(DEPTHS):
            exact = exact_field.radiance(depth, up)
            light = {kind: model.radiance(depth, up) for kind, model in models.items()}
            for weight in sensors:
                reference = exact @ weight
                for kind in kinds:
                    got = three.radiance(depth, up) if kind == "rgb" else light[kind] @ weight
                    relative[kind][i, j] += rms(got - reference) / rms(reference) / len(sensors)
                    exposure = np.sum(got * reference) / np.sum(got**2)
                    exposed[kind].append(rms(exposure * got - reference) / rms(reference))
                    white = reference.max()
                    distance = np.linalg.norm(_hsv_cone(got / white) - _hsv_cone(reference / white), axis=-1)
                    hsv[kind][i, j] += rms(distance) / len(sensors)
    for title, table in (("relative RMSE of the veil", relative), ("HSV distance of the veil", hsv)):
        print(f"{title}, mean of {len(sensors)} cameras\nwater  " + "".join(f"{kind:>9s}" for kind in kinds))
        for i, name in enumerate(JERLOV_TYPES):
            print(f"{name:5s}  " + "".join(f"{table[kind][i].mean():9.3f}" for kind in kinds))
        print("all    " + "".join(f"{table[kind].mean():9.3f}" for kind in kinds))
    print("after the best exposure of each picture: " + "  ".join(f"{k} {np.mean(v):.3f}" for k, v in exposed.items()))


def _veils(w: np.ndarray) -> np.ndarray:
    waters = [Water.jerlov(name) for name in JERLOV_TYPES]
    waters += [Water.jerlov(name, "williamson2022") for name in ("IB", "II", "III", "1C", "3C", "5C")]
    waters += [Water.chlorophyll(c) for c in (0.05, 0.5, 2.0)]
    rng = np.random.default_rng(5)
    rays = [(0.2 + rng.exponential(10, 60), rng.uniform(1, 20, 60), rng.uniform(-1, 1, 60)) for _ in waters]
    return np.concatenate([multiple_scattering(water, w, *ray) for water, ray in zip(waters, rays, strict=True)])


def section_bands() -> None:
    """Colour error of n wavelengths by three rules."""
    fine = bands(600).wavelength_nm
    exact_spectra = _veils(fine)
    counts = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
    for sensor in (Sensor.cie1931(), Sensor.camera("Insta360 X5")):
        exact = exact_spectra @ bands(600, sensor).weight
        print(
            f"{sensor.name}: colour error of n bands, mean / 95 % in per cent\n   n "
            + "".join(f"{r:>18s}" for r in RULES)
        )
        for n in counts:
            cells = []
            for rule in RULES:
                if rule == "fitted" and not 2 <= n <= 24:
                    cells.append(f"{'-':>18s}")
                    continue
                few = bands(n, sensor, rule)
                error = np.linalg.norm(_veils(few.wavelength_nm) @ few.weight - exact, axis=1) / np.linalg.norm(
                    exact, axis=1
                )
                cells.append(f"{100 * error.mean():10.2f} /{100 * np.quantile(error, 0.95):6.2f}")
            print(f"{n:4d} " + "".join(cells))
    errors = []
    for name in cameras():
        sensor = Sensor.camera(name)
        # the white for which the bands of all cameras are stored
        exact = exact_spectra @ bands(600, sensor, illuminant_name="equal-energy").weight
        row = []
        for n in (6, 12):
            few = bands(n, sensor, "fitted", "equal-energy")
            error = np.linalg.norm(_veils(few.wavelength_nm) @ few.weight - exact, axis=1) / np.linalg.norm(
                exact, axis=1
            )
            row += [error.mean(), np.quantile(error, 0.95)]
        errors.append(row)
    worst = 100 * np.max(errors, axis=0)
    middle = 100 * np.median(errors, axis=0)
    print("fitted, all cameras:  n = 6 mean, 95 %   n = 12 mean, 95 %")
    print(f"  median camera       {middle[0]:.2f}  {middle[1]:.2f}          {middle[2]:.2f}  {middle[3]:.2f}")
    print(f"  worst camera        {worst[0]:.2f}  {worst[1]:.2f}          {worst[2]:.2f}  {worst[3]:.2f}")


def section_objects() -> None:
    """RGB albedo times the grey object's transmittance, against spectra, for the colour checker's patches."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    patches = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    rng = np.random.default_rng(2)
    print("error of the seen colour over its size, mean / 95 % in per cent (D65, 400 rays a water)")
    print("water   sensor        per-channel transmittance   spectra from RGB (Mallett & Yuksel)")
    for sensor in (Sensor.cie1931(), Sensor.camera("Insta360 X5")):
        few = bands(61, sensor)
        w = few.wavelength_nm
        spectra = np.array([np.interp(w, sd.wavelengths, sd.values) for sd in patches.values()])
        albedo = bands(61, Sensor.cie1931()).rgb(spectra)
        for name in ("IB", "II", "1C", "5C"):
            medium = Medium(Water.jerlov(name), sensor, "table", 5.0)
            up = rng.uniform(-0.8, 0.5, 400)
            s = ray_in_water(rng.uniform(0.3, 1.5 * medium.length_m, 400), 5.0, up)
            depth = np.maximum(5.0 - s * up, 0.0)
            light = medium.model.irradiance(depth, 1.0)
            left = light * medium.spectral_transmittance(s)
            exact = few.rgb(left[:, None, :] * spectra)
            direct = few.rgb(spectra) * few.rgb(light)[:, None, :] * medium.transmittance(s, 5.0, up)[:, None, :]
            upsampled = few.rgb(left[:, None, :] * reflectance(np.clip(albedo, 0, 1), w))
            size = np.linalg.norm(few.rgb(left), axis=-1)[:, None]
            cells = []
            for got in (direct, upsampled):
                error = np.linalg.norm(got - exact, axis=-1) / size
                cells.append(f"{100 * error.mean():5.2f} / {100 * np.quantile(error, 0.95):5.2f}")
            print(f"{name:6s}  {sensor.name[-12:]:12s}  {cells[0]:>24s}   {cells[1]:>24s}")


def section_cost() -> None:
    """Time per pixel against the number of wavelengths."""
    water, sensor = Water.jerlov("II"), Sensor.camera("Insta360 X5")
    rng = np.random.default_rng(0)
    pixels = 250_000
    up, s = rng.uniform(-1, 1, pixels), rng.exponential(8.0, pixels)
    counts = (3, 8, 40, 200, 1000)
    media = {n: Medium(water, sensor, "kd", 5.0, band_count=n) for n in counts}
    tables = {n: media[n].table for n in counts}
    rounds: dict[int, list[float]] = {n: [] for n in counts}
    for _ in range(15):
        for n in counts:  # side by side, so that a busy machine slows all alike
            start = time.perf_counter()
            veil_lookup(tables[n], s, up)
            transmittance_lookup(tables[n], s, up)
            rounds[n].append(time.perf_counter() - start)
    best = {n: min(rounds[n]) for n in counts}
    print("bands    lookup [s/Mpixel]   over n = 8    direct sum [s/Mpixel]")
    for n in counts:
        few = 2000 if n > 100 else 20_000
        direct = median_time(lambda n=n, few=few: media[n].veil(s[:few], 5.0, up[:few]), 3) / few * 1e6
        print(f"{n:5d}    {best[n] / pixels * 1e6:.3f}               {best[n] / best[8]:.3f}         {direct:.2f}")
    seconds = median_time(lambda: Medium(water, sensor, "kd", 5.0).table, 5)
    print(f"table of mode kd, 61 bands: {1e3 * seconds:.0f} ms")
    Water.jerlov("III")
    start = time.perf_counter()
    _ = Medium(Water.jerlov("III"), sensor, "table", 5.0).table
    print(f"table of mode table, 61 bands, with the solve: {1e3 * (time.perf_counter() - start):.0f} ms")
    _gpu_cost(tables)


def _gpu_cost(tables: dict) -> None:
    from mr360uw.errors import GlError

    try:
        from mr360uw.gl import (
            draw_fullscreen,
            gl_context,
            program_from_text,
            set_uniforms,
            texture_from_array,
        )

        context = gl_context()
    except GlError as error:
        print(f"OpenGL: {error}")
        return
    shader = program_from_text(
        fragment='#include "medium/lookup.glsl"\nin vec2 uv; out vec4 colour; uniform MediumTable medium;\n'
        "uniform sampler2D veil, attenuation;\nvoid main() {\n"
        "float up = 2.0 * uv.y - 1.0, s = 20.0 * uv.x;\n"
        "colour = vec4(veil_lookup(medium, veil, s, up) + transmittance_lookup(medium, attenuation, s, up), 1.0);\n}\n"
    )
    target = context.framebuffer([context.texture((1000, 1000), 4, dtype="f4")])
    bound = {n: (texture_from_array(t.veil), texture_from_array(t.attenuation)) for n, t in tables.items()}
    rounds: dict[int, list[float]] = {n: [] for n in tables}
    for _ in range(15):
        for n, table in tables.items():
            for unit, (name, texture) in enumerate(zip(("veil", "attenuation"), bound[n], strict=True)):
                texture.use(unit)
                set_uniforms(shader, **{name: unit})
            set_uniforms(shader, medium__camera_depth_m=table.camera_depth_m, medium__length_m=table.length_m)
            start = time.perf_counter()
            draw_fullscreen(target, shader)
            context.finish()
            rounds[n].append(time.perf_counter() - start)
    best = {n: min(times) for n, times in rounds.items()}
    print(f"OpenGL ({context.info['GL_RENDERER'][:40]}), ms per million pixels, veil and transmittance:")
    print("  " + "   ".join(f"n = {n}: {1e3 * x:.2f} ({x / best[8]:.3f})" for n, x in best.items()))


def section_tables() -> None:
    """Error of the tables against direct sums."""
    rng = np.random.default_rng(0)
    print(
        "tables against 61 direct bands, per cent of the largest channel: veil mean / 95 %, transmittance mean / 95 %"
    )
    for sensor in (Sensor.cie1931(), Sensor.camera("Insta360 X5")):
        for mode in ("kd", "table"):
            for depth in (1.5, 5.0, 20.0):
                collected: list[np.ndarray] = []
                for name in JERLOV_TYPES:
                    medium = Medium(Water.jerlov(name), sensor, mode, depth)
                    up = rng.uniform(-1, 1, 2000)
                    s = ray_in_water(0.05 + rng.exponential(medium.length_m, 2000), depth, up)
                    veil = medium.veil(s, depth, up)
                    veil = compress_gamut(veil) if medium.bands.signed else veil
                    got = veil_lookup(medium.table, s, up)
                    seen = transmittance_lookup(medium.table, s, up) - medium.transmittance(s, depth, up)
                    collected.append(np.stack([np.abs(got - veil).max(-1) / veil.max(-1), np.abs(seen).max(-1)]))
                error = 100 * np.concatenate(collected, axis=1)
                q = np.quantile(error, 0.95, axis=1)
                print(
                    f"  {sensor.name[-11:]:11s} {mode:6s} {depth:4.1f} m   {error[0].mean():.3f} / {q[0]:.3f}    "
                    f"{error[1].mean():.3f} / {q[1]:.3f}"
                )


def section_gain() -> None:
    """Gain of the veil read from dives over sand, through 8-bit video, over that of the dive's own water.

    Of a video of one frame, and the mean over one of four. half a code: the largest error by half a code in Y', Cb, Cr.
    """
    from fractions import Fraction
    from tempfile import TemporaryDirectory

    from mr360uw.medium.veil_gain import fit_level
    from mr360uw.render.lights import level_view
    from mr360uw.sample import Dive, DiveSettings
    from mr360uw.sample.dive import record
    from mr360uw.video import open_video

    half_code = np.abs(rgb_from_ycbcr("bt709")) @ (0.5 / np.array([219.0, 224.0, 224.0]))
    print(
        "water  depth  sun   red     green   blue      mean of four frames     codes of the level water    "
        "half a code, %       residual"
    )
    for name in ("IA", "IB", "II", "1C", "3C"):
        for depth, sun in ((4.0, 57.3), (10.0, 35.0)):
            settings = DiveSettings(depth_m=depth, water=name, sun_elevation_deg=sun)
            plate = Dive(settings, 1024, 512)
            images = [plate.radiance(k / 6.0) for k in range(4)]
            medium = Medium(Water.jerlov(name), camera_depth_m=depth)
            fits = []
            with TemporaryDirectory() as folder:
                for clip in (images[:1], images):
                    record(Path(folder) / f"{len(clip)}.mp4", clip, Fraction(6 if clip[1:] else 24), 1)
                    with open_video(Path(folder) / f"{len(clip)}.mp4") as video:
                        fits += [fit_level(medium, level_view(frame.pixels)) for frame in video.frames()]
            level = plate.level_radiance
            ratios = np.array([gain for gain, _ in fits]) * medium.level_radiance(np.array([0.0]))[0] / level
            encoded = encode(level, "srgb")
            bound = 100.0 * (decode(encoded + half_code, "srgb") / level - 1.0)
            columns = (
                "".join(f"{x:8.3f}" for x in ratios[0]), "".join(f"{x:8.3f}" for x in ratios[1:].mean(axis=0)),
                "".join(f"{255.0 * x:7.0f}" for x in encoded), "".join(f"{x:7.1f}" for x in bound),
            )  # fmt: skip
            print(f"{name:5s} {depth:5.0f} {sun:6.1f}" + "  ".join(columns) + f"   {fits[0][1]:8.3f}")


def section_names() -> None:
    """Types that `fit_water` names in dives over sand, with the right white balance and one that is off by 12 %."""
    from mr360uw.medium import fit_water
    from mr360uw.medium.waterfit import CONFIDENT
    from mr360uw.render.lights import plate_map
    from mr360uw.sample import Dive, DiveSettings

    rng, found = np.random.default_rng(0), []
    for name in JERLOV_TYPES:
        cells = []
        for depth, sun, above in ((3.0, 70.0, 4.0), (9.0, 35.0, 4.0), (6.0, 50.0, 15.0)):
            settings = DiveSettings(depth_m=depth, floor_m=depth + above, water=name, sun_elevation_deg=sun)
            shown = plate_map(np.clip(Dive(settings, 256, 128).radiance(0.0), 0.0, 1.0))
            for balance in (np.ones(3), np.exp(rng.normal(0.0, 0.12, 3))):
                fit = fit_water(shown * balance, depth)
                found.append((fit.confidence, fit.water_type == name))
                cells.append(f"{fit.water_type:>4s} {fit.confidence:.2f}" + ("!" if fit.named else " "))
        print(f"{name:4s}" + "  ".join(cells))
    confidence, right = np.array(found).T
    named = confidence >= CONFIDENT
    print(
        f"nearest type right: {right.mean():.0%} of {len(right)}; named (!): {named.sum()}, "
        f"of them right {right[named].mean():.0%}"
    )


def section_store_bands() -> None:
    """Search the bands that ship with the package."""
    from mr360uw.medium.wavelengths import search
    from mr360uw.medium.wavelengths import storage_key as key_of

    stored = {}
    sensors = [Sensor.cie1931(), *map(Sensor.camera, cameras())]
    for sensor in sensors:
        both = sensor is sensors[0] or "Insta360" in sensor.name
        for light in ("equal-energy", "D65") if both else ("equal-energy",):
            for n in (4, 6, 8, 12):
                wavelength, weight = search(n, sensor, light, (400.0, 700.0))
                key = key_of(n, sensor, light, (400.0, 700.0))
                stored[key] = {"wavelength_nm": wavelength.tolist(), "weight": np.round(weight, 7).tolist()}
        print(sensor.name, flush=True)
    path = ROOT / "mr360uw" / "medium" / "data" / "fitted_bands.json"
    path.write_text(json.dumps(stored, separators=(",", ":")))


SECTIONS: dict[str, Callable[[], None]] = {
    "closed-form": section_closed_form,
    "field": section_field,
    "pictures": section_pictures,
    "models": section_models,
    "bands": section_bands,
    "objects": section_objects,
    "cost": section_cost,
    "tables": section_tables,
    "gain": section_gain,
    "names": section_names,
    "store-bands": section_store_bands,
}


def main() -> None:
    """Run the sections named on the command line."""
    wanted = sys.argv[1:] or [name for name in SECTIONS if name != "store-bands"]
    for name in wanted:
        if name not in SECTIONS:
            raise SystemExit(f"section - unknown (got {name!r}) - take one of {', '.join(SECTIONS)}")
        print(f"\n== {name} ==")
        SECTIONS[name]()


if __name__ == "__main__":
    main()
