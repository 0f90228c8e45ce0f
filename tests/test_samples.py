# SPDX-License-Identifier: Apache-2.0
"""Every sample runs: the scenes on the sample dive, the programs as a user starts them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import mr360uw as uw
from mr360uw.sample import SampleDive

SAMPLES = Path(__file__).resolve().parents[1] / "samples"
SCENES = sorted(SAMPLES.glob("*.toml"))
COARSE = [
    "water.bands=8", "water.rough=true", "caustics.size=64", "caustics.grid=32", "draw.samples=5", "draw.sun_samples=2",
]  # fmt: skip
"""Whether a sample runs does not depend on these."""
SKIPPED = {"murky": {"sun", "caustics", "shadow"}, "air": {"medium", "caustics"}}


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_scene_runs(path: Path, dive: SampleDive, tmp_path: Path) -> None:
    for file in (dive.plate, dive.mesh):
        (tmp_path / file.name).symlink_to(file)
    (tmp_path / path.name).write_text(path.read_text("utf-8"), "utf-8")
    report = uw.composite_video(uw.load_scene(tmp_path / path.name, COARSE), tmp_path / "out.mp4", frames=(0, 2))
    assert report.frames == 2
    assert report.empty_frames == 0
    for stage in SKIPPED.get(path.stem, ()):
        assert not report.plan.stages[stage].runs


@pytest.mark.parametrize(
    ("program", "says"),
    [("light_probe.py", "deg above it"), ("caustic_loop.py", "16 maps"), ("water_colors.py", "water_colors.png")],
)
def test_a_program_runs(program: str, says: str, dive: SampleDive, tmp_path: Path) -> None:
    argument = dive.plate if program == "light_probe.py" else tmp_path
    done = subprocess.run(
        [sys.executable, str(SAMPLES / program), str(argument)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert says in done.stdout


def test_every_sample_is_in_the_readme() -> None:
    text = (SAMPLES / "README.md").read_text("utf-8")
    for path in [*SCENES, *SAMPLES.glob("*.py")]:
        assert f"`{path.name}" in text
