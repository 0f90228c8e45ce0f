# SPDX-License-Identifier: Apache-2.0
"""Live preview: time from a changed parameter to an encoded picture, stages run, seeking, start, memory.

    python benchmarks/live.py [--moves N] [--hours H] [--clip VIDEO] [SECTION ...]

Sections: start, moves, scrub, memory; without one, all of them. Times are medians, on the wall and of the processor.
--clip: a video to seek in; by default one of 3840x1920, H.264, with a keyframe every 48 frames, is made.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from mr360uw.preview.live import COARSE_WIDTH, LivePreview
from mr360uw.preview.live import coarse as draft_of
from mr360uw.preview.screen import screen_picture
from mr360uw.sample import sample_dive
from mr360uw.scene.model import PlateSettings, Scene, load_scene
from mr360uw.scene.resolved import open_plate

WIDTH = 1024
Move = Callable[[np.random.Generator], tuple[str, ...]]
MOVES: dict[str, Move] = {
    "object.position_m": lambda r: (f"object.0.position_m=[{r.uniform(0, 1)}, {r.uniform(-1, -0.3)}, -3.6]",),
    "object.rotation_deg": lambda r: (f"object.0.rotation_deg=[{r.uniform(-30, 30)}, 4, 0]",),
    "object.scale": lambda r: (f"object.0.scale={r.uniform(0.7, 1.3)}",),
    "object.roughness": lambda r: (f"object.0.roughness={r.uniform(0.2, 0.9)}",),
    "camera.depth_m": lambda r: (f"camera.depth_m={r.uniform(3, 6)}",),
    "water.type": lambda r: (f"water.type={r.choice(['I', 'IA', 'IB', 'II', 'III', '1C', '3C'])}",),
    "water.visibility_m": lambda r: (f"water.visibility_m={r.uniform(8, 30)}",),
    "water.gain": lambda r: (f"water.gain=[{r.uniform(0.3, 0.6)}, 0.5, 0.5]",),
    "light.sun_azimuth_deg": lambda r: ("light.sun=given", f"light.sun_azimuth_deg={r.uniform(0, 60)}"),
    "light.sun_elevation_deg": lambda r: ("light.sun=given", f"light.sun_elevation_deg={r.uniform(50, 70)}"),
    "light.direct_to_diffuse": lambda r: (f"light.direct_to_diffuse={r.uniform(0.5, 2)}",),
    "sea.wind_speed": lambda r: (f"sea.wind_speed={r.uniform(2, 8)}",),
    "caustics.sun_half_angle": lambda r: (f"caustics.sun_half_angle_rad={r.uniform(0.004, 0.03)}",),
    "receiver.height_m": lambda r: (f"receiver.height_m={r.uniform(-4, -3)}",),
    "draw.sun_spread_deg": lambda r: (f"draw.sun_spread_deg={r.uniform(2, 8)}",),
    "draw.grain": lambda r: (f"draw.grain={r.uniform(0, 1)}",),
}
SHOWN = (
    "KeptFrames._decoded",
    "plate_light",
    "PlatePattern",
    "solved",
    "exposed_water",
    "summed_stack",
    "draw_layer",
    "VideoFrame.over",
)


def sample(folder: Path) -> Path:
    """Return the scene file of a dive of eight frames, made once."""
    path = folder / "scene.toml"
    return path if path.exists() else sample_dive(folder, width=WIDTH, frames=8).scene


def scene_of(path: Path, changes: tuple[str, ...]) -> Scene:
    """Return the scene with some keys changed; a visibility stands in place of the type."""
    if any("visibility" in change for change in changes):
        scene = load_scene(path)
        water = scene.water.model_dump(include={"sensor", "sun_share", "sun_elevation_deg"})
        water["visibility_m"] = float(changes[0].partition("=")[2])
        return scene.model_copy(update={"water": type(scene.water)(**water)})
    return load_scene(path, changes)


def shown(live: LivePreview, scene: Scene, *, coarse: bool) -> bytes:
    """Return an encoded frame."""
    wanted = (draft_of(scene), 0, COARSE_WIDTH) if coarse else (scene, 0, WIDTH)
    frame = live.frame(*wanted)
    return screen_picture(frame.picture.image_linear)


def timed(work: Callable[[], Any]) -> tuple[float, float]:
    """Return the time [ms] of a call on the wall and of the processor."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - processor)


def start(path: Path) -> None:
    """Print the time of the first pictures."""
    live: list[LivePreview] = []
    print(f"start         {timed(lambda: live.append(LivePreview()))[0]:8.0f} ms  {live[0].backend.device}")
    scene = load_scene(path)
    print(f"first draft   {timed(lambda: shown(live[0], scene, coarse=True))[0]:8.0f} ms")
    print(f"first frame   {timed(lambda: shown(live[0], scene, coarse=False))[0]:8.0f} ms")
    frame = live[0].frame(scene, 0, WIDTH).picture.image_linear
    print(f"JPEG alone    {min(timed(lambda: screen_picture(frame))[1] for _ in range(9)):8.1f} ms of the processor")
    live[0].close()


def moves(path: Path, count: int) -> None:
    """Print the times and the stages of a move of each parameter."""
    print(f"{'':24} draft: wall, processor   frame: wall, processor [ms]   stages a move")
    with LivePreview() as live:
        for coarse in (True, False):
            shown(live, load_scene(path), coarse=coarse)
        for name, move in MOVES.items():
            times, run = [], live.made
            for coarse in (True, False):
                rng = np.random.default_rng(list(name.encode()))
                scenes = [scene_of(path, move(rng)) for _ in range(count)]
                before = live.made.copy()
                found = [timed(partial(shown, live, scene, coarse=coarse)) for scene in scenes]
                times += [statistics.median(column) for column in zip(*found, strict=True)]
                run = live.made - before
            stages = "  ".join(f"{stage} {run[stage] / count:.1f}" for stage in SHOWN if run[stage])
            draft, frame = (f"{wall:9.0f} {processor:9.0f}" for wall, processor in (times[:2], times[2:]))
            print(f"{name:24}{draft}    {frame}            {stages}", flush=True)


def scrub(clip: Path) -> None:
    """Print the time to frames of a clip in random order, in order, and of thumbnails."""
    scene, rng = Scene(plate=PlateSettings(path=clip)), np.random.default_rng(1)
    with LivePreview("reference") as live:
        about = live.clip(scene)
        last = (about.frame_count or 1) - 1
        print(f"clip          {about.width}x{about.height}, {about.frame_count} frames, {clip.stat().st_size >> 20} MB")
        orders = {
            "random frames": [int(rng.integers(last + 1)) for _ in range(40)],
            "in order": list(range(last // 2, min(last // 2 + 30, last))),
        }
        for name, order in orders.items():
            found = [timed(partial(live.plate, scene, index, WIDTH)) for index in order]
            wall, processor = (statistics.median(column) for column in zip(*found, strict=True))
            print(f"{name:14}{wall:8.0f} ms  processor {processor:6.0f} ms  slowest {max(w for w, _ in found):6.0f} ms")
        wall, processor = timed(lambda: live.plates.overview(scene, 24, 160))
        print(f"24 thumbnails {wall:8.0f} ms  processor {processor:6.0f} ms")


def memory(path: Path, count: int, hours: float) -> None:
    """Print the memory over random moves: `count` of them, or as many as there is time for."""
    rng, began, done = np.random.default_rng(3), time.monotonic(), 0
    with LivePreview() as live:
        while (time.monotonic() - began < 3600.0 * hours) if hours else done < count:
            if done % max(count // 8, 1) == 0:
                print(f"{done:7} moves  {resident_mb():6.0f} MB", flush=True)
            move = MOVES[rng.choice(list(MOVES))]
            shown(live, scene_of(path, move(rng)), coarse=rng.random() < 0.7)
            done += 1
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{done:7} moves  {resident_mb():6.0f} MB, at most {peak:.0f} MB")
    print(f"closed         {resident_mb():6.0f} MB")


def resident_mb() -> float:
    """Return the memory of this process."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def made_clip(path: Path, dive: Path) -> Path:
    """Return a clip of 192 frames, 3840x1920, of a dive's frames with grain; a keyframe every 48."""
    if path.exists():
        return path
    with open_plate(load_scene(dive)) as video:
        pictures = [np.clip(255.0 * frame.image_linear ** (1 / 2.2), 0, 255) for frame in video.frames()]
    large = [cv2.resize(picture, (3840, 1920), interpolation=cv2.INTER_CUBIC) for picture in pictures]
    grain = np.random.default_rng(1).normal(0.0, 1.5, (2048, 4096, 1)).astype(np.float32)
    with av.open(str(path), "w", format="mp4") as out:
        stream: Any = out.add_stream("libx264", rate=Fraction(30000, 1001))
        stream.width, stream.height, stream.pix_fmt = 3840, 1920, "yuv420p"
        stream.options = {"preset": "fast", "crf": "20", "g": "48", "keyint_min": "48", "sc_threshold": "0"}
        for number in range(192):
            shifted = np.roll(large[number // 4 % len(large)], 2 * number, axis=1)
            j, i = 37 * number % 128, 61 * number % 256
            codes = np.clip(shifted + grain[j : j + 1920, i : i + 3840], 0, 255).astype(np.uint8)
            out.mux(stream.encode(av.VideoFrame.from_ndarray(codes, format="rgb24")))
        out.mux(stream.encode(None))
    return path


def main() -> None:
    """Run the sections that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sections", nargs="*", default=["start", "moves", "scrub", "memory"])
    parser.add_argument("--moves", type=int, default=50)
    parser.add_argument("--hours", type=float, default=0.0)
    parser.add_argument("--clip", type=Path)
    asked = parser.parse_args()
    folder = Path(tempfile.gettempdir()) / "mr360uw-live"
    dive = sample(folder)
    sections: dict[str, Callable[[], None]] = {
        "start": lambda: start(dive),
        "moves": lambda: moves(dive, asked.moves),
        "scrub": lambda: scrub(asked.clip or made_clip(folder / "large.mp4", dive)),
        "memory": lambda: memory(dive, 20 * asked.moves, asked.hours),
    }
    for name in asked.sections:
        sections[name]()


if __name__ == "__main__":
    main()
