# SPDX-License-Identifier: Apache-2.0
"""Closed loop: dives by the generator of `uw.surface`, composited by the pipeline, against the generator's own picture
with the body in it.

    python benchmarks/closed_loop.py [--quick] [--seeds A:B] [--width W] [--json FILE] [--pictures FOLDER]
                                     [--keep FOLDER]

20 dives by seed. Five waters, suns of 25 to 80 degrees, cameras 2 to 15 m deep, floors 1.5 to 6 m below them, winds of
2 to 8 m/s. Each is a clip of two seconds of H.264, as a camera would record it. The scene has the water's type, the
depths, the sea and where the body is; the rest is found in the clip. The truth's light on the body is gathered ray by
ray from the generator's sky, sun, water and floor (`benchmarks/closed`), and shares tables of water and caustics with
the pipeline, but nothing of its compositing.

found: sun, gain and environment from the clip. told: sun, its fraction of the light, and the veil's gain are given.
known: the plate is the generator's light, neither clipped nor coded, and the environment that of its mean sea.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))


import mr360uw as uw  # noqa: E402
from benchmarks.closed.bodies import write_body  # noqa: E402
from benchmarks.closed.dives import Dive  # noqa: E402
from benchmarks.closed.gathering import Gathering  # noqa: E402
from benchmarks.closed.truth import Stage, TruePicture, exposure  # noqa: E402
from mr360uw.base.cache import Cache  # noqa: E402
from mr360uw.base.color import encode, luminance  # noqa: E402
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA  # noqa: E402
from mr360uw.composite.tiles import over  # noqa: E402
from mr360uw.ibl.lighting import assemble  # noqa: E402
from mr360uw.ibl.lookup import environment_lookup  # noqa: E402
from mr360uw.ibl.plate import COARSE_COLUMNS  # noqa: E402
from mr360uw.render.first_pass import ClipAnalysis, clip_analysis  # noqa: E402
from mr360uw.render.frame import frame_shots, make_backend  # noqa: E402
from mr360uw.render.loaded import load  # noqa: E402
from mr360uw.render.plate_light import plate_light  # noqa: E402
from mr360uw.sample.dive import record  # noqa: E402
from mr360uw.scene.model import Scene, scene_from_dict  # noqa: E402
from mr360uw.types import (  # noqa: E402
    Environment,
    Floats,
    Sun,
)
from mr360uw.video import VideoFrame  # noqa: E402

RATE = Fraction(4)
FRAMES = 8
JUDGED = (2,)
"""Frames that are compared."""
COLUMNS = ("found", "told", "known")
PSNR_DB = 34.0
WITHIN = 0.04
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Row:
    """One dive in one column.

    sun_deg: error of the sun's direction in the water, nan where none is found. light: irradiance of a level plane at
    the camera over the generator's, less 1; direct: the sun's fraction of it, less the generator's. psnr_db: of codes
    (sRGB, white = 1) over body and shadow. body, shadow: (3,) mean light over the generator's.
    """

    seed: int
    column: str
    sun_deg: float
    light: float
    direct: float
    psnr_db: float
    body: list[float]
    shadow: list[float]

    @property
    def meets(self) -> tuple[bool, bool, bool]:
        """Whether picture, body and shadow are within their targets."""
        near = (bool(np.all(np.abs(np.array(a) - 1.0) <= WITHIN)) for a in (self.body, self.shadow))
        return (self.psnr_db >= PSNR_DB, *near)  # type: ignore[return-value]


def scene_of(dive: Dive, folder: Path, *, told: bool, gain: float) -> Scene:
    """Return the scene that a user would write; told: with the light that the generator has."""
    stage = Stage(dive, 64)
    (sky, _), (sun, _) = stage.water.parts
    data: dict[str, Any] = {
        "plate": "dive.mp4",
        "camera": {"depth_m": dive.camera_depth_m},
        "water": {"type": dive.water},
        "sea": dive.sea.model_dump(exclude_unset=True),
        "object": [
            {
                "mesh": "body.glb", "position_m": dive.center.tolist(),
                "rotation_deg": [float(np.degrees(dive.yaw_rad)), 0.0, 0.0], "base_color": dive.albedo.tolist(),
                "metallic": 0.0, "roughness": 1.0, "refractive_index": REFRACTIVE_INDEX_SEA,
            }
        ],
        "receiver": {"height_m": -dive.above_floor_m},
    }  # fmt: skip
    if told:
        up = float(dive.sun_in_water[1])
        share = float(luminance(sun) / luminance(sun + sky))
        elevation = float(np.degrees(np.arcsin(up)))
        data["water"] |= {"sun_share": share, "sun_elevation_deg": elevation, "gain": [gain] * 3}
        data["light"] = {
            "sun": "given", "sun_azimuth_deg": float(np.degrees(dive.azimuth_rad)), "sun_elevation_deg": elevation,
        }  # fmt: skip
    return scene_from_dict(data, folder)


@dataclass(frozen=True, eq=False)
class Clip:
    """A recorded dive. frames: the generator's, by index, in the units of its exposure."""

    stage: Stage
    folder: Path
    exposure: float
    frames: dict[int, TruePicture]

    @classmethod
    def make(cls, stage: Stage, folder: Path) -> Clip:
        """Render and record a dive."""
        write_body(stage.dive, folder / "body.glb")
        first = stage.plate(0.0, 1)
        factor = exposure(first)
        frames: dict[int, TruePicture] = {}

        def images() -> Iterator[Floats]:
            for index in range(FRAMES):
                time_s = float(index / RATE)
                judged = index in JUDGED
                plate = first if index == 0 else stage.plate(time_s, 2 if judged else 1)
                if judged:
                    frames[index] = stage.frame(plate, time_s)
                yield (plate * factor).astype(np.float32)

        record(folder / "dive.mp4", images(), RATE, stage.dive.seed)
        return cls(stage, folder, factor, frames)

    def rows(self, pictures: Path | None) -> Iterator[Row]:
        """Composite the clip in every way and return what differs."""
        dive = self.stage.dive
        for column in COLUMNS:
            scene = scene_of(dive, self.folder, told=column != "found", gain=self.exposure)
            with uw.open_video(self.folder / "dive.mp4") as video:
                analysis = clip_analysis(load(scene, video.width, video.height), video)
                plates = {frame.index: frame.image_linear for frame in video.frames(0, FRAMES) if frame.index in JUDGED}
            pairs, environments = [], []
            for index in JUDGED:
                if column == "known":
                    image, environment = self._known(scene, index)
                else:
                    result = uw.render_frame(plates[index], scene, float(index / RATE), index=index, analysis=analysis)
                    image, environment = result.image_linear, result.environment
                environments.append(environment)
                pairs.append((image.astype(np.float64), self.frames[index]))
            yield self._row(column, pairs, environments[0])
            if pictures is not None:
                self._show(pictures / f"{dive.seed:02}-{column}.png", *pairs[0])

    def _known(self, scene: Scene, index: int) -> tuple[Floats, Environment]:
        """Return the composite of a frame lit by the generator's mean light about the camera, and that light."""
        dive, water = self.stage.dive, self.stage.water
        up = float(dive.sun_in_water[1])
        beam = sum(water.beam(np.array([dive.camera_depth_m])))[0] * self.exposure / up
        sun = Sun(dive.sun_in_water, beam, dive.sun.half_angle_rad / REFRACTIVE_INDEX_SEA, 1.0)
        around = (Gathering(dive, water).map(COARSE_COLUMNS) * self.exposure).astype(np.float32)
        environment = assemble(around, sun)
        plate = VideoFrame.of_linear(
            (self.frames[index].plate * self.exposure).astype(np.float32), index, float(index / RATE)
        )
        loaded = load(scene, self.stage.width, self.stage.width // 2, clip=False)
        light = replace(plate_light(loaded, ClipAnalysis(), plate), environment=environment)
        backend, cache = make_backend("auto")[0], Cache()
        shots = frame_shots(loaded, ClipAnalysis(), backend, plate, 0.0, cache, light)
        layer, _ = backend.layer(shots.eyes[0][1][0].shot)
        return over(plate.image_linear, layer), environment

    def _row(self, column: str, pairs: list[tuple[Floats, TruePicture]], environment: Environment) -> Row:
        dive, water = self.stage.dive, self.stage.water
        error, count = 0.0, 0
        sums = {"body": np.zeros((2, 3)), "shadow": np.zeros((2, 3))}
        for ours, frame in pairs:
            truth = frame.truth * self.exposure
            both = frame.body | frame.shadow
            a, b = (encode(np.clip(image[both], 0.0, 1.0), "srgb") for image in (ours, truth))
            error, count = error + float(np.sum((a - b) ** 2)), count + a.size
            for name, where in (("body", frame.body), ("shadow", frame.shadow)):
                sums[name] += np.stack([np.clip(image[where], 0, 1).sum(axis=0) for image in (ours, truth)])
        sun = environment.sun
        found = environment_lookup(environment.irradiance, UP)
        truth_light = water.down(dive.camera_depth_m) * self.exposure
        beam = sum(water.beam(np.array([dive.camera_depth_m])))[0] * self.exposure
        direct = (
            0.0 if sun is None else float(luminance(sun.irradiance * max(sun.direction[1], 0.0)) / luminance(found))
        )
        angle = np.nan
        if sun is not None:
            angle = float(np.degrees(np.arccos(np.clip(sun.direction @ dive.sun_in_water, -1.0, 1.0))))
        psnr = -10.0 * float(np.log10(max(error / count, 1e-12)))
        return Row(
            dive.seed, column, angle, float(luminance(found) / luminance(truth_light)) - 1.0,
            direct - float(luminance(beam) / luminance(truth_light)), psnr,
            *((s[0] / np.maximum(s[1], 1e-12)).tolist() for s in sums.values()),
        )  # fmt: skip

    def _show(self, path: Path, ours: Floats, frame: TruePicture) -> None:
        """Write truth, ours and eight times the difference about grey, of body and shadow and what is near."""
        import cv2

        both = frame.body | frame.shadow
        height, width = both.shape
        turn = width // 2 - int(np.round(_middle_column(both)))
        both, *images = (np.roll(a, turn, axis=1) for a in (both, frame.truth * self.exposure, ours))
        rows, columns = (np.flatnonzero(both.any(axis=k)) for k in (1, 0))
        top, bottom = max(rows[0] - 12, 0), min(rows[-1] + 12, height)
        left, right = max(columns[0] - 12, 0), min(columns[-1] + 12, width)
        a, b = (encode(np.clip(i[top:bottom, left:right], 0.0, 1.0), "srgb") for i in images)
        sheet = np.concatenate([a, b, np.clip(0.5 + 8.0 * (b - a), 0.0, 1.0)], axis=1 if b.shape[1] < b.shape[0] else 0)
        cv2.imwrite(str(path), (255.0 * sheet[..., ::-1]).round().astype(np.uint8))


def _middle_column(mask: np.ndarray) -> float:
    """Return the middle column of a mask that may cross the seam."""
    turn = np.exp(2j * np.pi * np.arange(mask.shape[1]) / mask.shape[1])
    return float(np.angle(np.sum(mask.sum(axis=0) * turn)) / (2 * np.pi) * mask.shape[1]) % mask.shape[1]


def _line(row: Row) -> str:
    marks = "".join("+" if met else "-" for met in row.meets)
    means = "  ".join(" ".join(f"{v:5.2f}" for v in a) for a in (row.body, row.shadow))
    start = f"{row.column:7} {row.sun_deg:6.2f} {100 * row.light:+6.1f} {100 * row.direct:+6.1f}"
    return f"{start} {row.psnr_db:6.1f}  {means}  {marks}"


def main(arguments: list[str]) -> int:
    """Run the dives; print a row for each and what meets the targets."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="three dives")
    parser.add_argument("--seeds", default="1:21", help="range A:B of seeds")
    parser.add_argument("--width", type=int, default=1024, help="of the frames")
    parser.add_argument("--json", type=Path, help="file for the rows")
    parser.add_argument("--pictures", type=Path, help="folder for truth, ours and eight times the difference")
    parser.add_argument("--keep", type=Path, help="folder in which clips and truths are kept from run to run")
    options = parser.parse_args(arguments)
    first, last = (int(a) for a in options.seeds.split(":"))
    rows: list[Row] = []
    print(
        "                    sun    light  direct  PSNR   body r g b         shadow r g b       meets: PSNR body shadow"
    )
    print("                    deg      %      %      dB    mean over the truth's")
    for seed in range(first, last)[:: 5 if options.quick else 1][: 3 if options.quick else None]:
        dive, began = Dive.of(seed), time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            clip = _kept(dive, options.width, options.keep, Path(folder))
            made = time.process_time() - began
            print(
                f"{seed:2} {dive.water:3} {dive.shape:5} sun {np.degrees(dive.elevation_rad):.0f} deg, camera "
                f"{dive.camera_depth_m:.1f} m, floor {dive.above_floor_m:.1f} m below, wind {dive.wind_m_s:.1f} m/s"
            )
            for row in clip.rows(options.pictures):
                print("           " + _line(row), flush=True)
                rows.append(row)
            print(f"           {made:.0f} + {time.process_time() - began - made:.0f} s of processor time")
    summary(rows)
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1), "utf-8")
    return 0


def _kept(dive: Dive, width: int, keep: Path | None, folder: Path) -> Clip:
    """Return the clip of a dive, from an earlier run if it was kept."""
    if keep is None:
        return Clip.make(Stage(dive, width), folder)
    folder, stage = keep / f"{dive.seed}-{width}", Stage(dive, width)
    stored = folder / "truth.npz"
    if not stored.exists():
        folder.mkdir(parents=True, exist_ok=True)
        clip = Clip.make(stage, folder)
        arrays = {f"{name}{k}": getattr(f, name) for k, f in clip.frames.items() for name in f.__dataclass_fields__}
        np.savez(stored, exposure=clip.exposure, **arrays)
    data = np.load(stored)
    names = TruePicture.__dataclass_fields__
    frames = {k: TruePicture(*(data[f"{name}{k}"] for name in names)) for k in JUDGED}
    return Clip(stage, folder, float(data["exposure"]), frames)


def summary(rows: list[Row]) -> None:
    """Print how many rows of each column meet the targets, and medians."""
    for column in COLUMNS:
        of = [row for row in rows if row.column == column]
        met, found = np.array([row.meets for row in of]), [row.sun_deg for row in of if np.isfinite(row.sun_deg)]
        psnr, light = np.median([row.psnr_db for row in of]), np.median([abs(row.light) for row in of])
        print(
            f"{column:7} of {len(of)}: PSNR >= {PSNR_DB:g} dB {met[:, 0].sum()}, body within {100 * WITHIN:g} % "
            f"{met[:, 1].sum()}, shadow {met[:, 2].sum()}, all {met.all(axis=1).sum()}; medians: {psnr:.1f} dB, "
            f"light {100 * light:.1f} %, sun {np.median(found) if found else np.nan:.2f} deg, "
            f"not found {len(of) - len(found)}"
        )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
