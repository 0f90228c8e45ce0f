# SPDX-License-Identifier: Apache-2.0
"""Runs that are killed, and memory over long runs: python benchmarks/survive.py [crash | memory | calls |
scenes] [options].

crash: `composite` is killed (kill -9) at random times, over three codecs and numbered pictures (--kills in all, 20).
The same command must then finish; its output must be that of a run that was not killed, packet by packet (encoders are
deterministic with one thread); every complete part must be used again, and at most one be incomplete; files with names
like temporary ones must stay as they are; a second run to the same output must be refused.

memory: resident memory of a run of --frames frames (10000) of 512 x 256, in MiB; from frame 300 on it must stay within
5 %. calls: the same over 50 library calls in one process, from the tenth on. scenes: --scenes different ones (60), each
drawn by a `Compositor` of its own in one process; at most 3 MiB a scene from the tenth on. All leave with 1 where a
figure is missed.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import mr360uw as uw  # noqa: E402
from mr360uw.base.files import matching_files, work_path  # noqa: E402
from mr360uw.sample import SampleDive, sample_dive  # noqa: E402
from mr360uw.scene.model import load_scene  # noqa: E402
from mr360uw.video import EncodeSettings, create_video  # noqa: E402

CRASH_WIDTH, CRASH_FRAMES, SEGMENT = 128, 24, 3
"""Pictures 64 wide are too narrow: x264's macroblock tree then reads memory that it has not written; packets vary."""
KINDS = {
    "h264": ("out.mp4", []),
    "h265": ("out.mkv", ["output.codec=h265"]),
    "ffv1": ("out.mkv", ["output.codec=ffv1"]),
    "png": ("out_%04d.png", []),
}
"""Outputs and settings; of one thread the encoders are deterministic."""
COARSE = ["draw.samples=1", "draw.sun_samples=1", "draw.ambient_occlusion=false"]
"""How runs go on does not depend on how fine the pictures are."""
STEADY_FROM, CALLS, CALLS_FROM = 300, 50, 10
MIB_A_SCENE = 3.0
TOLERANCE = 0.05
"""Allowed spread of the resident memory, as a fraction of its median."""


@dataclass(frozen=True)
class Command:
    """A `composite` command of a kind of output in a folder."""

    dive: SampleDive
    folder: Path
    kind: str

    @property
    def out(self) -> Path:
        """The output."""
        return self.folder / KINDS[self.kind][0]

    @property
    def report(self) -> Path:
        """The file of the report."""
        return self.folder.with_suffix(".json")

    def start(self) -> subprocess.Popen[str]:
        """Start it, with nothing on the terminal."""
        settings = [f"output.segment_s={SEGMENT / 24}", *COARSE, *KINDS[self.kind][1]]
        arguments = [part for setting in settings for part in ("--set", setting)]
        command = [sys.executable, "-m", "mr360uw", "composite", str(self.dive.scene), str(self.out), *arguments]
        return subprocess.Popen(
            [*command, "--backend", "reference", "--report", str(self.report)], cwd=ROOT, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        )  # fmt: skip

    def finish(self) -> int:
        """Run it to its end; return the number of frames that were there already."""
        running = self.start()
        _, said = running.communicate()
        if running.returncode:
            raise SystemExit(f"{self.kind}: ended with {running.returncode}: {said}")
        return int(json.loads(self.report.read_text())["frames"]["kept_from_a_stopped_run"])

    def content(self) -> str:
        """Return a hash of the output's packets, or of its pictures."""
        found = hashlib.sha256()
        if self.kind == "png":
            for _, file in matching_files(self.out):
                found.update(file.read_bytes())
            return found.hexdigest()
        import av

        with av.open(str(self.out)) as container:
            for packet in container.demux():
                found.update(f"{packet.stream_index} {packet.pts} {packet.dts} ".encode() + bytes(packet))
        return found.hexdigest()

    def complete(self) -> tuple[int, int]:
        """Return the number of frames that are complete in the work folder, and of parts that are not."""
        work = work_path(self.out)
        if self.kind == "png":
            return sum(file.read_text().count("\n[") for file in work.glob("written-*")), 0
        tables, data = {p.stem for p in work.glob("0*.npz")}, {p.stem for p in work.glob("0*.packets")}
        return SEGMENT * len(tables), len(data - tables)


def crash(kills: int, seed: int) -> list[str]:
    """Kill runs at random times and let them finish; return what went wrong."""
    dice, wrong = np.random.default_rng(seed), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        dive = sample_dive(folder / "dive", width=CRASH_WIDTH, frames=CRASH_FRAMES)
        print(f"{'output':8}{'killed at':>11}{'complete':>10}{'incomplete':>12}{'kept':>6}  same as not killed")
        for number, kind in enumerate(KINDS):
            whole = Command(dive, folder / f"{kind}-whole", kind)
            whole.folder.mkdir()
            began = time.monotonic()
            whole.finish()
            lasts_s, expected = time.monotonic() - began, whole.content()
            for k in range(number, kills, len(KINDS)):
                command = Command(dive, folder / f"{kind}-{k}", kind)
                command.folder.mkdir()
                foreign = _foreign(command.folder)
                at_s = dice.uniform(0.3, 1.0) * lasts_s
                running = command.start()
                try:
                    running.communicate(timeout=at_s)
                except subprocess.TimeoutExpired:
                    running.send_signal(signal.SIGKILL)
                    running.communicate()
                # a run may be complete and be killed as it leaves
                finished = not work_path(command.out).exists() and _exists(command)
                complete, incomplete = (CRASH_FRAMES, 0) if finished else command.complete()
                kept = complete if finished else command.finish()
                same = command.content() == expected
                line = f"{kind:8}{at_s:9.2f} s{complete:10}{incomplete:12}{kept:6}  {same}"
                print(line, flush=True)
                problems = {
                    "another output": not same,
                    "complete parts made again": kept < complete,
                    "more than one part incomplete": incomplete > 1,
                    "other files changed": _foreign_now(command.folder) != foreign,
                    "left-over files": len(list(command.folder.iterdir())) != len(foreign) + _files_of(kind),
                }
                wrong += [f"{line}: {problem}" for problem, here in problems.items() if here]
        wrong += _two_at_once(dive, folder)
    return wrong


def _exists(command: Command) -> bool:
    """Return whether an output is there."""
    return bool(matching_files(command.out)) if command.kind == "png" else command.out.exists()


def _files_of(kind: str) -> int:
    """Return the number of files of an output."""
    return CRASH_FRAMES if kind == "png" else 1


def _foreign(folder: Path) -> dict[str, str]:
    """Make files of other programs with names like temporary ones; return their content."""
    (folder / "precious.txt").write_text("precious")
    (folder / "out.mp4.part").symlink_to(folder / "precious.txt")
    for name in ("out.mkv.part", ".out.part.mp4", "out_0000.png.part"):
        (folder / name).write_text("mine")
    return _foreign_now(folder)


def _foreign_now(folder: Path) -> dict[str, str]:
    names = ("precious.txt", "out.mp4.part", "out.mkv.part", ".out.part.mp4", "out_0000.png.part")
    return {name: f"{(folder / name).is_symlink()} {(folder / name).read_text()}" for name in names}


def _two_at_once(dive: SampleDive, folder: Path) -> list[str]:
    """Start a command while the same one runs; return what went wrong."""
    command = Command(dive, folder / "twice", "h264")
    command.folder.mkdir()
    first = command.start()
    while not (work_path(command.out) / "run.json").exists() and first.poll() is None:
        time.sleep(0.02)
    second = command.start()
    _, said = second.communicate()
    first.communicate()
    print(f"second run: exit code {second.returncode}, {said.strip()}")
    refused = second.returncode == 2 and "another run is writing it" in said
    return [] if refused and first.returncode == 0 else ["a second run was not refused, or the first one failed"]


def resident_mib() -> float:
    """Return this process's resident memory [MiB] (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def judged(what: str, seen: list[float]) -> list[str]:
    """Print the spread of the resident memory; return a line if it is too large."""
    middle = float(np.median(seen))
    spread = max(max(seen) / middle - 1.0, 1.0 - min(seen) / middle)
    line = f"{what}: {min(seen):.0f} to {max(seen):.0f} MiB, median {middle:.0f}, within {100 * spread:.1f} %"
    print(line)
    return [line] if spread > TOLERANCE else []


def memory(frames: int, backend: str) -> list[str]:
    """Run over a long clip; return what went wrong."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        dive = sample_dive(folder / "dive", width=512, frames=24)
        long = folder / "long.mp4"
        with uw.open_video(dive.plate) as video:
            pictures = [frame.image_linear for frame in video.frames()]
            settings = EncodeSettings(preset="ultrafast", sound=False)
            with create_video(long, video, settings) as writer:
                for k in range(frames):  # to and fro, so that nothing jumps
                    writer.write_image(pictures[min(k % 46, 46 - k % 46)])
        scene = load_scene(dive.scene, [f'plate.path="{long}"'])
        seen: dict[int, float] = {}
        began = time.monotonic()

        def progress(done: int, total: int | None) -> None:  # noqa: ARG001 - as progress is called
            if done % 25 == 0:
                seen[done] = resident_mib()  # of the first pass too; the frames' own come later and replace them
            if done % 500 == 0:
                print(f"  {done} frames: {resident_mib():.0f} MiB, {time.monotonic() - began:.0f} s", flush=True)

        report = uw.composite_video(scene, folder / "out.mp4", backend=backend, progress=progress)
    print(f"{report.frames} frames of 512 x 256 by {report.backend}: {report.frames / report.seconds:.1f} frames/s")
    return judged(f"resident from frame {STEADY_FROM} on", [mib for k, mib in seen.items() if k >= STEADY_FROM])


def calls(backend: str) -> list[str]:
    """Composite a short clip many times in one process; return what went wrong."""
    seen = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        dive = sample_dive(folder / "dive", width=64, frames=4)
        for k in range(CALLS):
            scene = load_scene(dive.scene, [f"object.0.position_m=[0.4, -0.6, {-3.6 - 0.01 * k}]"])
            uw.composite_video(scene, folder / "out.mp4", backend=backend, overwrite=True)
            plate = np.full((32, 64, 3), 0.2, np.float32)
            uw.render_frame(plate, scene, float(Fraction(k, 24)), backend)
            gc.collect()
            seen.append(resident_mib())
    return judged(f"resident from call {CALLS_FROM} on, {backend}", seen[CALLS_FROM:])


def scenes(count: int, backend: str) -> list[str]:
    """Draw a frame of each of many scenes that share nothing; return what went wrong."""
    waters, seen = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C"), []
    with tempfile.TemporaryDirectory() as name:
        dive = sample_dive(Path(name) / "dive", width=64, frames=1)
        plate = np.random.default_rng(1).uniform(0.1, 0.3, (256, 512, 3)).astype(np.float32)
        for k in range(count):
            given = [f"camera.depth_m={4.0 + 0.25 * k}", f'water.type="{waters[k % len(waters)]}"', f"sea.seed={k}"]
            with uw.Compositor(load_scene(dive.scene, given), backend=backend) as compositor:
                compositor.frame(plate)
            seen.append(resident_mib())
    grown = [after - before for before, after in pairwise(seen)]
    rest = (seen[-1] - seen[CALLS_FROM - 1]) / (count - CALLS_FROM) if count > CALLS_FROM else 0.0
    line = f"{count} scenes, {backend}: {seen[0]:.0f} to {max(seen):.0f} MiB, {rest:.2f} MiB a scene from the tenth on"
    print(f"{line} (at most {max(grown, default=0.0):.1f})")
    return [line] if rest > MIB_A_SCENE else []


def main() -> None:
    """Run what is asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", nargs="?", choices=["crash", "memory", "calls", "scenes"])
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--backend", default="auto")
    given = parser.parse_args()
    wrong: list[str] = []
    if given.what in (None, "crash"):
        wrong += crash(given.kills, given.seed)
    if given.what in (None, "memory"):
        wrong += memory(given.frames, given.backend)
    if given.what in (None, "calls"):
        wrong += calls(given.backend)
    if given.what in (None, "scenes"):
        wrong += scenes(given.scenes, given.backend)
    for line in wrong:
        print(f"MISSED {line}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
