# SPDX-License-Identifier: Apache-2.0
"""How well suns are found and given their strength: python benchmarks/suns.py [section] [count]

Sections: discs (drawn here; count = largest width, default 4096), dives (synthetic; count = dives, default 30),
closure, photographs; default: all. Maps and photographs are those of ../shared/data/footage; without them the last two
are left out.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable

import numpy as np
from light import FOOTAGE, angle, clipped, hdr, picture, table

import mr360uw.ibl as ibl
from mr360uw.color import luminance
from mr360uw.ibl.plate import LinearPlate
from mr360uw.ibl.sun.detect import find_disc
from mr360uw.optics import refract_to_water
from mr360uw.sample import Dive, DiveSettings
from mr360uw.sphere import direction_from_frame, directions, row_solid_angle, unit

RADII_DEG = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.0)
EXPOSURES = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
PLACES = (unit([0.3, 0.8, 0.2]), unit([-0.7, 0.25, 0.6]))
SHARES = (0.001, 0.003, 0.01, 0.03, 0.1)
CHOSEN_ON = ("KernerEnvLatLong.exr", "blender_city_dwab.exr", "polyhaven_venice.hdr", "StageEnvLatLong.exr")
HELD_OUT = ("polyhaven_sky.hdr", "polyhaven_sunrise.hdr", "polyhaven_forest.hdr", "OrientationLatLong.exr")
TINT = np.array([1.1, 1.0, 0.8])


def disc(width: int, radius_deg: float, radiance: float, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a map with a disc whose rim pixels are covered in part, and the disc's irradiance (3,)."""
    fine, height = 16, width // 2
    d = directions(width, height)
    sky = np.where(d[..., 1] > 0.0, 0.2 + 0.15 * d[..., 1], 0.08)
    row, column = np.nonzero(d @ place > np.cos(np.radians(radius_deg + 1.5)))
    part = (np.arange(fine) + 0.5) / fine
    covered = np.zeros_like(sky)
    for k in range(0, len(row), 20_000):
        j, i = row[k : k + 20_000], column[k : k + 20_000]
        longitude = 2.0 * np.pi * ((i[:, None, None] + part) / width - 0.5)
        latitude = np.pi * (0.5 - (j[:, None, None] + part[:, None]) / height)
        flat = np.sin(longitude) * place[0] - np.cos(longitude) * place[2]
        inside = np.cos(latitude) * flat + np.sin(latitude) * place[1] > np.cos(np.radians(radius_deg))
        covered[j, i] = inside.mean(axis=(1, 2))
    put = (covered * row_solid_angle(width, height)[:, None]).sum() * radiance * TINT
    return (sky[..., None] + radiance * covered[..., None] * TINT).astype(np.float32), put


def discs(widest: int = 4096) -> None:
    """Print how discs of every size are judged and measured."""
    print("Discs of 0.25 to 5 degrees of radius: unclipped at five exposures, and clipped to white")
    print("(targets: one decision at every radius, exposure and width; direction 0.1 degrees, irradiance 2 %)")
    print("A disc of one or two pixels has no place in them: 0.25 degrees in 512 columns may be off by 0.16.")
    for radiance, name in ((3000.0, "10^4 times the sky"), (3.0, "10 times the sky: no sun while unclipped")):
        rows = []
        for width in (w for w in (512, 1024, 2048, 4096) if w <= widest):
            for place in PLACES:
                open_sure, white_sure, off, energy, size = [], [], [], [], []
                for radius_deg in RADII_DEG:
                    image, put = disc(width, radius_deg, radiance, place)
                    for exposure in EXPOSURES:
                        sun = ibl.detect_sun(image * np.float32(exposure)) if radiance > 3.0 or exposure < 0.3 else None
                        open_sure.append(sun is not None and sun.confidence >= 0.5)
                        if sun is not None and open_sure[-1]:
                            off.append(angle(sun.direction, place))
                            energy.append(abs(float(luminance(sun.irradiance) / luminance(put * exposure)) - 1.0))
                            size.append(abs(np.degrees(sun.half_angle_rad) - radius_deg) / 360.0 * width)
                    white = ibl.detect_sun(np.minimum(image, 1.0))
                    white_sure.append(white is not None and white.confidence >= 0.5)
                worst = [max(values, default=0.0) for values in (off, energy, size)]
                share = [f"{sum(sure)} of {len(sure)}" for sure in (open_sure, white_sure)]
                elevation = float(np.degrees(np.arcsin(place[1])))
                rows.append((width, elevation, *share, worst[0], 100.0 * worst[1], worst[2]))
        print(f"  {name}")
        head = (
            "width",
            "elevation",
            "unclipped: suns",
            "clipped: suns",
            "worst deg",
            "worst irradiance %",
            "radius px",
        )
        table(head, rows)


def photographs() -> None:
    """Print the sun of each sunny photograph, or its best candidate and the reason."""
    print("Sunny photographs (tolerance 20 pixels of the width)")
    truths = json.loads((FOOTAGE / "360" / "sun_truth_ldr.json").read_text("utf-8"))["images"]
    rows = []
    for name in (*truths, "360/chichen-itza.jpg"):
        found = find_disc(LinearPlate.of(picture(name)))
        if found is None:
            continue
        # the last by eye: the middle of the grey disc, greyer than the clouds about it
        entry = truths.get(name, {"x": 352, "y": 90, "width": 2048, "height": 1024, "tol_px": 20})
        place = direction_from_frame(entry["x"], entry["y"], entry["width"], entry["height"])
        off = angle(found.blob.direction, place) / 360.0 * entry["width"]
        rows.append((name, off, entry["tol_px"], found.confidence, found.reason))
    table(("picture", "error px", "tolerance", "confidence", "what speaks against it"), rows)


def dive_settings(seed: int) -> DiveSettings:
    """Return a dive at random whose sun shows: in clearer water than these the whole of Snell's window clips."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(2.5, 8.0)
    return DiveSettings(
        depth_m=depth,
        floor_m=depth + rng.uniform(2.0, 5.0),
        water=("IB", "II")[rng.integers(2)],
        sun_azimuth_deg=rng.uniform(-180.0, 180.0),
        sun_elevation_deg=rng.uniform(35.0, 85.0),
        seed=seed,
    )


def dives(count: int = 30) -> None:
    """Print the error of the sun of synthetic dives, whose waves move it."""
    print(
        f"The sun of {count} dives of 48 frames, 2 s, 512 columns, 8 bit; seeds 0 to 9 were looked at, these were not"
    )
    print("(targets: median .4 degrees, 95 % within 1.5, frame to frame .02)")
    rows, errors, steps, raw = [], [], [], []
    for seed in range(100, 100 + count):
        settings = dive_settings(seed)
        truth, plate = refract_to_water(settings.sun_in_air), Dive(settings, 512, 256)
        frames = (clipped(plate.radiance(k / 24.0), 1.0) for k in range(48))
        suns = [ibl.measure_sun(ibl.environment(f, underwater=True), k / 24.0) for k, f in enumerate(frames)]
        found = ibl.track_suns(suns)
        seen = [angle(m.sun.direction, truth) for m in suns if m.sun is not None]
        if not seen:
            rows.append((seed, settings.water, "-", np.nan, np.nan, np.nan))
            errors.append(90.0)
            continue
        error = [angle(d, truth) for d in found.direction]
        step = max(angle(a, b) for a, b in itertools.pairwise(found.direction))
        elevation = f"{settings.sun_elevation_deg:.0f}"
        rows.append((seed, settings.water, elevation, float(np.median(seen)), max(error), step))
        errors += [max(error)]
        steps.append(step)
        raw += seen
    table(("seed", "water", "elevation", "frame by frame, median deg", "track, worst deg", "frame to frame deg"), rows)
    print(
        f"  track: median {np.median(errors):.2f} deg, 95 % {np.quantile(errors, 0.95):.2f} deg, "
        f"frame to frame at most {max(steps):.3f}; frame by frame: median {np.median(raw):.2f} deg\n"
    )


def exposed(name: str, share: float) -> float:
    """Return the exposure that clips this share of the sphere in a map's brightest channel."""
    value = hdr(name).max(axis=-1)
    height, width = value.shape
    weight = np.broadcast_to(row_solid_angle(width, height)[:, None], value.shape).ravel() / (4.0 * np.pi)
    order = np.argsort(-value.ravel())
    return float(1.0 / value.ravel()[order[np.searchsorted(np.cumsum(weight[order]), share)]])


def closure() -> None:
    """Print how far the light of clipped maps is from that of the maps."""
    print("Irradiance of clipped maps over the true one, in stops: on a level plane, and in brackets the median of")
    print("|stops| over the planes that face up; s: with a sun. What has no sun lost light wherever anything clipped.")
    print("(targets: median |stops| over the maps .15, .15, .2, .3, .6; lost nothing: less than .1)")
    rows: list[tuple[object, ...]] = []
    level, upward = {share: [] for share in SHARES}, {share: [] for share in SHARES}
    facing = directions(64, 32)[..., 1] > 0.0
    for name in CHOSEN_ON + HELD_OUT:
        truth = luminance(ibl.environment(hdr(name), expansion="none").irradiance)
        cells = []
        for share in SHARES:
            exposure = exposed(name, share)
            light = ibl.environment(clipped(hdr(name), exposure))
            stops = np.log2(luminance(light.irradiance) / (exposure * truth))
            flat, median = float(stops[0].mean()), float(np.median(np.abs(stops[facing])))
            level[share].append(abs(flat))
            upward[share].append(median)
            cells.append(f"{flat:+.2f} ({median:.2f}){' s' if light.sun is not None else ''}")
        rows.append((name, "made with" if name in CHOSEN_ON else "held out", *cells))
    table(("map", "", *(f"{100.0 * share:g} %" for share in SHARES)), rows)
    half = len(CHOSEN_ON)
    rows = []
    for label, part in (("all", slice(None)), ("made with", slice(half)), ("held out", slice(half, None))):
        for kind, values in (("level plane", level), ("planes facing up", upward)):
            rows.append((label, kind, *(float(np.median(values[share][part])) for share in SHARES)))
    table(("median |stops|", "", *(f"{100.0 * share:g} %" for share in SHARES)), rows)


SECTIONS: dict[str, Callable[..., None]] = {
    "discs": discs,
    "dives": dives,
    "closure": closure,
    "photographs": photographs,
}


def main(arguments: list[str]) -> int:
    """Run the sections named by the arguments."""
    wanted = arguments[:1] or list(SECTIONS)
    if wanted[0] not in SECTIONS:
        print(f"section - unknown (got {wanted[0]!r}) - take one of {', '.join(SECTIONS)}")
        return 2
    for name in wanted:
        if name in ("closure", "photographs") and not FOOTAGE.is_dir():
            print(f"{name}: needs the pictures in {FOOTAGE.name}, which are not beside this checkout; left out\n")
            continue
        SECTIONS[name](*(int(a) for a in arguments[1:2]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
