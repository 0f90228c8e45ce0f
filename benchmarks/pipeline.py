# SPDX-License-Identifier: Apache-2.0
"""What compositing costs beside plain decoding and encoding, and how much memory it takes.

    python benchmarks/pipeline.py [rate] [memory] [--runs N] [--width W] [--frames N] [--scene FILE]

rate: composite / plain transcode of one clip with the same settings, taken in turns; medians of the ratios of wall time
and of processor time, children included; every run measures its first pass anew. Without a scene file: a sample dive
with two whales that stand still, without and with a receiver; two whales that swim while the camera sinks, and twenty
that swim, where little can be kept. --frames: length of the sample dive; what a run costs once shows in short ones.
memory: peak of a whole process over 120 and over 1200 frames.
"""

from __future__ import annotations

import argparse
import math
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import mr360uw as uw  # noqa: E402
from benchmarks.cost.process_cost import processor_s  # noqa: E402
from mr360uw.scene.model import Scene, load_scene, scene_from_dict  # noqa: E402
from mr360uw.types import Floats  # noqa: E402
from mr360uw.video import transcode  # noqa: E402

_OBJECTS: list[dict[str, Any]] = [
    {"mesh": "whale.glb", "animation": "", "position_m": [0.4, -0.6, -4.2], "rotation_deg": [120.0, -4.0, 0.0]},
    {
        "mesh": "whale.glb", "animation": "", "scale": 0.4, "position_m": [-1.6, -1.6, -3.2],
        "rotation_deg": [-110.0, 5.0, 0.0],
    },
]  # fmt: skip


_DEPTH_M = 4.0
_SECONDS, _SINKS_M = 2.0, 1.0
"""Time [s] in which whales swim their way, and how far the camera sinks in it [m]; in longer clips it is all of it."""
_FRAME_RATE = 24
"""Frames a second of the sample dive."""


def scene_of(folder: Path, receiver: bool = True) -> Scene:
    """Return the scene that is measured: two meshes, water, caustics, shadows on a plane."""
    return scene_from_dict(
        {
            "plate": "dive.mp4",
            "camera": {"depth_m": _DEPTH_M},
            "water": {"type": "IB"},
            "object": _OBJECTS,
            **({"receiver": {"height_m": -3.5}} if receiver else {}),
        },
        folder,
    )


def sinking_scene(folder: Path, seconds: float = _SECONDS) -> Scene:
    """Return the scene with two whales that swim while the camera sinks towards the floor, in some seconds."""
    swimming = [_swimming(whale, forward_m, seconds) for whale, forward_m in zip(_OBJECTS, (1.6, -0.8), strict=True)]
    still = scene_of(folder)
    depths = [[0.0, _DEPTH_M], [seconds, _DEPTH_M + _SINKS_M]]
    return scene_from_dict(
        {
            "plate": str(still.plate.path), "camera": {"depth_m": _DEPTH_M, "depth_keys": depths},
            "water": {"type": "IB"}, "object": swimming, "receiver": {"height_m": -3.5},
        },
        folder,
    )  # fmt: skip


def crowded_scene(folder: Path, seconds: float = _SECONDS) -> Scene:
    """Return the scene with twenty small whales that swim some seconds, all round the camera, above a receiver."""
    school = []
    for number in range(20):
        yaw, far = 18.0 * number, 2.5 + 0.5 * (number % 5)
        x, z = far * math.sin(math.radians(yaw)), -far * math.cos(math.radians(yaw))
        y = -1.8 + 0.4 * (number % 7)
        placed = {
            "mesh": "whale.glb",
            "scale": 0.25,
            "position_m": [x, y, z],
            "rotation_deg": [40.0 * number, 3.0, 0.0],
        }
        school.append(_swimming(placed, 0.8 if number % 2 else -0.8, seconds))
    tables = {"camera": {"depth_m": _DEPTH_M}, "water": {"type": "IB"}, "receiver": {"height_m": -3.5}}
    return scene_from_dict({"plate": "dive.mp4", "object": school, **tables}, folder)


def _swimming(whale: dict[str, Any], along_m: float, seconds: float) -> dict[str, Any]:
    """Return an object that moves to the right by some metres in some seconds."""
    x, y, z = whale["position_m"]
    keys = [{"time_s": 0.0, "position_m": [x, y, z]}, {"time_s": seconds, "position_m": [x + along_m, y + 0.2, z]}]
    return {**whale, "key": keys}


def rate(scene: Scene, folder: Path, runs: int, what: str) -> None:
    """Print frames per second of plain transcoding and of compositing, and their ratio, run by run.

    The ratio of processor time is that of plain over composite too: both are 1 where compositing costs nothing.
    """
    plate = scene.plate.path
    uw.composite_video(scene, folder / "warm.mp4", frames=(0, 4), overwrite=True)
    ratios, of_cpu, plain_fps, composite_fps, frame_cpu = [], [], [], [], []
    for _ in range(runs):
        began, used = time.perf_counter(), processor_s()
        count = transcode(plate, folder / "plain.mp4", scene.output, overwrite=True)
        plain_fps.append(count / (time.perf_counter() - began))
        plain_cpu, used = (processor_s() - used) / count, processor_s()
        report = uw.composite_video(scene, folder / "composite.mp4", overwrite=True, fresh=True)
        composite_fps.append(report.frames / report.seconds)
        frame_cpu.append((processor_s() - used) / report.frames)
        ratios.append(composite_fps[-1] / plain_fps[-1])
        of_cpu.append(plain_cpu / frame_cpu[-1])
    image = _first(plate)
    tiles = uw.render_frame(image, scene).layer.tiles
    touched = sum(tile.alpha.size for tile in tiles) / image[..., 0].size
    receiver = "with a receiver" if scene.receiver is not None else "no receiver"
    print(f"{what}: {plate.name}, {report.frames} frames, {len(scene.objects)} meshes, {receiver}, on {report.device}")
    print(f"  tiles      {100 * touched:6.2f} % of the pixels")
    print(f"  plain      {statistics.median(plain_fps):6.2f} frames/s")
    print(f"  composite  {statistics.median(composite_fps):6.2f} frames/s")
    print(f"  ratio      {statistics.median(ratios):6.3f}   (runs: {', '.join(f'{r:.3f}' for r in ratios)})")
    print(f"  CPU ratio  {statistics.median(of_cpu):6.3f}   (runs: {', '.join(f'{r:.3f}' for r in of_cpu)})")
    print(f"  CPU        {1e3 * statistics.median(frame_cpu):6.1f} ms a frame")
    print("  " + ", ".join(f"{name} {1e3 * s / report.frames:.1f} ms" for name, s in report.stage_s.items()))


def _first(path: Path) -> Floats:
    with uw.open_video(path) as video:
        return next(iter(video.frames(0, 1))).image_linear


_CHILD = """
import sys
from pathlib import Path

sys.path.insert(0, {root!r})
import mr360uw as uw
from benchmarks.cost.process_cost import peak_kib
from benchmarks.pipeline import scene_of
folder, count = Path({folder!r}), {count}
report = uw.composite_video(scene_of(folder), folder / "memory.mp4", frames=(0, count), overwrite=True, fresh=True)
print(report.frames, peak_kib())
"""


def memory(folder: Path) -> None:
    """Print the peak memory of compositing 120 and 1200 frames of one clip."""
    dive = uw.sample_dive(folder, width=512, frames=48, overwrite=True)
    _repeat(dive.plate, folder / "long.mp4", 1200)
    shutil.move(folder / "long.mp4", dive.plate)
    peaks = {}
    for count in (120, 1200):
        code = _CHILD.format(root=str(ROOT), folder=str(folder), count=count)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        frames, kilobytes = map(int, done.stdout.split())
        peaks[frames] = kilobytes / 1024.0
        print(f"  {frames:5d} frames: peak {peaks[frames]:.0f} MiB")
    print(f"  difference {100 * (peaks[1200] / peaks[120] - 1):+.1f} %")


def _repeat(source: Path, target: Path, frames: int) -> None:
    """Write a clip again and again, up to a number of frames, without sound."""
    import av

    with av.open(str(source)) as given:
        pictures = list(given.decode(video=0))
        rate = given.streams.video[0].average_rate
    with av.open(str(target), "w") as made:
        stream = made.add_stream("libx264", rate=rate, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = pictures[0].width, pictures[0].height, "yuv420p"
        for k in range(frames):
            picture = pictures[k % len(pictures)]
            picture.pts, picture.pict_type = k, 0
            picture.time_base = 1 / rate
            made.mux(stream.encode(picture))
        made.mux(stream.encode(None))


def main() -> None:
    """Run the sections named on the command line, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", default=[], metavar="rate|memory")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--width", type=int, default=2048)
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--scene", type=Path)
    given = parser.parse_args()
    for section in given.sections or ["rate", "memory"]:
        print(f"== {section}")
        with tempfile.TemporaryDirectory() as folder:
            if section == "memory":
                memory(Path(folder))
                continue
            for what, scene in measured_scenes(Path(folder), given.scene, given.width, given.frames).items():
                rate(scene, Path(folder), given.runs, what)


def measured_scenes(folder: Path, file: Path | None, width: int, frames: int = 48) -> dict[str, Scene]:
    """Return the scenes of `rate` by what they show: of a file without and with its receiver, or of a sample dive.

    width, frames: of the dive.
    """
    if file is not None:
        scene = load_scene(file)
        found = {"scene": scene.model_copy(update={"receiver": None})}
        return found | ({"scene with its receiver": scene} if scene.receiver is not None else {})
    uw.sample_dive(folder, width=width, frames=frames)
    seconds = max(_SECONDS, frames / _FRAME_RATE)
    return {
        "standing still": scene_of(folder, receiver=False),
        "standing still, shadows": scene_of(folder),
        "swimming, the camera sinks": sinking_scene(folder, seconds),
        "twenty that swim": crowded_scene(folder, seconds),
    }


if __name__ == "__main__":
    main()
