# SPDX-License-Identifier: Apache-2.0
"""How well suns are found and given their strength: python benchmarks/suns.py [section] [count]

Sections: discs (drawn here; count = largest width, default 4096), dives (synthetic; count = dives, default 30),
closure, photographs, verdict (count = dives, default 60); default: all. Maps and photographs are those of
../shared/data/footage; without them closure and photographs are left out, and verdict has dives alone.
"""

from __future__ import annotations

import itertools
import json
import sys
import zlib
from collections.abc import Callable, Iterator

import numpy as np
from light import FOOTAGE, angle, clipped, hdr, middle, picture, table

import mr360uw.ibl as ibl
from mr360uw.base.color import luminance
from mr360uw.base.optics import refract_to_water
from mr360uw.base.sphere import direction_from_frame, directions, row_solid_angle, unit, yaw_matrix
from mr360uw.ibl.plate import LinearPlate
from mr360uw.ibl.sun.detect import find_disc
from mr360uw.ibl.sun.spots import taken_share
from mr360uw.sample import Dive, DiveSettings

RADII_DEG = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.0)
EXPOSURES = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
PLACES = (unit([0.3, 0.8, 0.2]), unit([-0.7, 0.25, 0.6]))
SHARES = (0.001, 0.003, 0.01, 0.03, 0.1)
CHOSEN_ON = ("KernerEnvLatLong.exr", "blender_city_dwab.exr", "polyhaven_venice.hdr", "StageEnvLatLong.exr")
HELD_OUT = ("polyhaven_sky.hdr", "polyhaven_sunrise.hdr", "polyhaven_forest.hdr", "OrientationLatLong.exr")
SUN_MAPS = ("KernerEnvLatLong.exr", "blender_city_dwab.exr", "polyhaven_sky.hdr", "polyhaven_sunrise.hdr")
NO_SUN_MAPS = (
    "StageEnvLatLong.exr", "OrientationLatLong.exr", "polyhaven_forest.hdr", "polyhaven_venice.hdr",
    "polyhaven_dawn.hdr", "polyhaven_city.hdr", "polyhaven_night.hdr",
)  # fmt: skip
"""All maps but the sunset, whose sun on the horizon gives under 1 % of the light of a level plane."""
NO_SUN_PICTURES = (
    "360/machu-picchu.jpg", "360/pannellum_examplepano.jpg", "360/gopro_max_stitched_GS018423_1.jpg",
    "360/congo_forest_stereo_tb.mp4", "360/overpass_mono.mp4",
    "underwater360/catlin_pedras_secas_two_stereo_tb.jpg",
)  # fmt: skip
CASTLE = {"x": 352, "y": 90, "width": 2048, "height": 1024, "tol_px": 20}
"""By eye: the middle of the grey disc, greyer than the clouds about it."""
_MOST_CLIPPED = 0.1
"""Share of the pixels above the horizon that are white up to which the sun in them is visible."""
_NEAR_DEG = 10.0
"""Angle up to which a sun is in its place: waves move that of one frame of a dive by up to 6 degrees."""
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
        found = find_disc(LinearPlate(picture(name)))
        if found is None:
            continue
        entry = truths.get(name, CASTLE)
        place = direction_from_frame(entry["x"], entry["y"], entry["width"], entry["height"])
        off = angle(found.direction, place) / 360.0 * entry["width"]
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


def cases(count: int) -> Iterator[tuple[str, np.ndarray, np.ndarray | None, bool]]:
    """Yield name, plate, direction (3,) of its sun or None, and whether it is under water, of what is judged."""
    for name in SUN_MAPS + NO_SUN_MAPS if FOOTAGE.is_dir() else ():
        image, place = hdr(name), None
        if name in SUN_MAPS:
            truth = json.loads((FOOTAGE / "hdr" / "sun_truth.json").read_text("utf-8"))["maps"][name]
            place = direction_from_frame(truth["x"], truth["y"], truth["width"], truth["height"])
        for stops in range(-5, 0):
            plate = clipped(image, middle(image) * 2.0**stops)
            if place is None or np.mean(plate[: len(plate) // 2].max(axis=-1) == 1.0) < _MOST_CLIPPED:
                yield f"{name} {stops}", *turned(plate, place, f"{name} {stops}"), False
        yield f"{name} unclipped", *turned(image, place, name), False
    truths = (
        json.loads((FOOTAGE / "360" / "sun_truth_ldr.json").read_text("utf-8"))["images"] if FOOTAGE.is_dir() else {}
    )
    truths |= {"360/chichen-itza.jpg": CASTLE} if truths else {}
    for name in (*truths, *NO_SUN_PICTURES) if truths else ():
        entry = truths.get(name)
        place = direction_from_frame(entry["x"], entry["y"], entry["width"], entry["height"]) if entry else None
        for turn in range(3):
            label = f"{name} turn {turn}"
            yield label, *turned(picture(name), place, label if turn else ""), name.startswith("underwater")
    for seed in range(count):
        dive = Dive(dive_of_any_water(seed), 512, 256)
        for time_s in (0.0, 1.3):
            yield f"dive {seed} {time_s}", clipped(dive.radiance(time_s), 1.0), dive.sun_in_water, True


def turned(image: np.ndarray, place: np.ndarray | None, seed: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Return a map and a direction (3,) turned about the vertical by an angle of the seed's; "" does not turn it."""
    columns = zlib.crc32(seed.encode()) % image.shape[1]
    turn = yaw_matrix(2.0 * np.pi * columns / image.shape[1])
    return np.roll(image, columns, axis=1), None if place is None else turn @ place


def dive_of_any_water(seed: int) -> DiveSettings:
    """Return one of the dives in all ten types of water, every third ten of them under an overcast sky."""
    rng, water = (
        np.random.default_rng([seed, 31]),
        ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")[seed % 10],
    )
    depth = rng.uniform(1.0, 6.0) if water.endswith("C") else rng.uniform(1.5, 12.0)
    return DiveSettings(
        depth_m=depth, floor_m=depth + rng.uniform(2.0, 6.0), water=water,
        sky="overcast" if seed // 10 % 3 == 2 else "clear",
        sun_azimuth_deg=rng.uniform(-180.0, 180.0), sun_elevation_deg=rng.uniform(15.0, 85.0),
        wind_m_s=rng.uniform(1.0, 8.0), stops=rng.uniform(-0.5, 1.5), seed=seed,
    )  # fmt: skip


def verdict(count: int = 60) -> None:
    """Print how many visible suns are used, by half of their light or more, and how many are claimed in vain."""
    print("Suns of maps (five exposures, 8 bit, and unclipped), photographs (three turns) and dives of ten waters")
    print(f"(targets: used 95 %, claimed 3 %; used: within {_NEAR_DEG:g} degrees of the truth. Halves by the CRC-32 of")
    print("the name, exposure and turn included. Kinds and scales of evidence were found on plates of both halves)")
    tally: dict[tuple[str, bool, int], list[float]] = {}
    for name, plate, place, underwater in cases(count):
        found = find_disc(LinearPlate(plate), underwater=underwater)
        share = 0.0 if found is None else taken_share(found.confidence)
        near = found is not None and place is not None and angle(found.direction, place) < _NEAR_DEG
        right = share >= 0.5 and near if place is not None else share < 0.5
        if not right:
            spot = "nothing" if found is None else f"confidence {found.confidence:.2f}; {found.reason}"
            print(f"  {'missed ' if place is not None else 'claimed'}  {name}: {spot}")
        half = zlib.crc32(name.encode()) % 2
        tally.setdefault(("under water" if underwater else "in air", place is not None, half), []).append(right)
    rows = []
    for where in ("in air", "under water", "all"):
        cells = []
        for half, sun in itertools.product((0, 1), (True, False)):
            kinds = ("in air", "under water") if where == "all" else (where,)
            every = [right for kind in kinds for right in tally.get((kind, sun, half), [])]
            hits = sum(every) if sun else len(every) - sum(every)
            cells.append(f"{hits:g} of {len(every)}, {100.0 * hits / max(len(every), 1):.1f} %")
        rows.append((where, *cells))
    table(("", "first half: used", "claimed", "second half: used", "claimed"), rows)


SECTIONS: dict[str, Callable[..., None]] = {
    "discs": discs,
    "dives": dives,
    "closure": closure,
    "photographs": photographs,
    "verdict": verdict,
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
