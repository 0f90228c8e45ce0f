# SPDX-License-Identifier: Apache-2.0
"""The benchmark: stages of known cost and error, two runs compared, the command, one real stage."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from mr360uw.bench import bench_report
from mr360uw.bench.bench_report import (
    BenchReport,
    Machine,
    StageResult,
    beats,
    bench_page,
    better_than_default,
    compare,
    front,
    pareto_plot,
    read_report,
)
from mr360uw.bench.stages import (
    STAGES,
    MeasuredStage,
    Measurement,
    Workbench,
    Workload,
    frames_against,
    measure,
    qualities,
    relative_rms,
    timed,
)
from mr360uw.errors import ParameterError
from mr360uw.render.frame import Reference
from mr360uw.sample import SampleDive
from mr360uw.scene.model import Scene

MACHINE = Machine(cpu="a processor", cores=2, system="an OS", backend="gl", device="a device", load=0.1)
POINTS = tuple({"steps": steps} for steps in (1, 10, 100))


def at(cpu_ms: float, error: float, *names: str, steps: int = 0) -> Measurement:
    return Measurement({"steps": steps}, cpu_ms, cpu_ms, error, 5, names)


def report_of(*found: Measurement, quick: bool = True, machine: Machine = MACHINE) -> BenchReport:
    stage = StageResult(name="sum", title="A <sum>", timed="work", truth="pi", measurements=found)
    return BenchReport(version="1", packages={"numpy": "2"}, machine=machine, quick=quick, stages=(stage,))


def fake_stage(calls: list[Any]) -> MeasuredStage:
    """A sum of `steps` terms whose error is exactly 1/steps."""

    def prepare(knobs: Any) -> Callable[[int], float]:
        return lambda k: calls.append((knobs["steps"], k)) or 1.0 + 1.0 / knobs["steps"]

    def opened(bench: Workbench) -> Workload:
        del bench
        return prepare, lambda got: relative_rms(got, 1.0)

    return MeasuredStage("sum", "A sum", "adding", "its limit", POINTS, POINTS[:1], {"default": {"steps": 10}}, opened)


def test_a_stage_is_measured_at_its_settings(tmp_path: Path) -> None:
    calls: list[Any] = []
    stage, ticks = fake_stage(calls), []
    found = measure(stage, Workbench(tmp_path, Reference()), lambda: ticks.append(1))
    assert [(m.knobs["steps"], m.names) for m in found] == [(10, ("default",)), (1, ()), (100, ())]
    assert [m.error for m in found] == pytest.approx([0.1, 1.0, 0.01])
    assert len(ticks) == 3
    assert calls[:6] == [(10, k) for k in range(6)]  # one for the error, five that are timed
    assert len(measure(stage, Workbench(tmp_path, Reference(), quick=True))) == 2
    assert not list(tmp_path.iterdir())


def test_times_are_medians_of_two_clocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clocks are set by the work itself, so that what else the machine does changes nothing."""
    clock = {"cpu": 0.0, "wall": 0.0}
    monkeypatch.setattr(time, "process_time", lambda: clock["cpu"])
    monkeypatch.setattr(time, "perf_counter", lambda: clock["wall"])
    seen: list[int] = []

    def work(number: int) -> None:
        seen.append(number)
        clock["cpu"] += (0.0, 0.3, 0.1, 0.2)[number]
        clock["wall"] += (0.0, 0.5, 0.7, 0.6)[number]

    cpu, wall = timed(work, 3)
    assert (cpu, wall) == pytest.approx((0.2, 0.6))
    assert seen == [1, 2, 3]

    def long(number: int) -> None:
        seen.append(number)
        clock["wall"] += 3.0

    assert timed(long, 5)[1] == pytest.approx(3.0)
    assert seen[3:] == [1, 2]  # more than 4 s are enough


def test_relative_errors() -> None:
    assert relative_rms(np.array([3.0, 5.0]), np.array([3.0, 4.0])) == pytest.approx((0.5 / 12.5) ** 0.5)
    assert relative_rms(np.zeros(3), np.zeros(3)) == 0.0


def test_the_front_has_what_nothing_beats() -> None:
    cheap, usual, exact = at(1.0, 0.5), at(10.0, 0.1, "default"), at(100.0, 0.0)
    dear, coarse = at(50.0, 0.2), at(9.0, 0.6)
    assert front([exact, dear, usual, coarse, cheap]) == [cheap, usual, exact]
    assert not better_than_default([exact, dear, usual, coarse, cheap])
    assert better_than_default([usual, at(5.0, 0.1), at(9.0, 0.05)]) == [at(9.0, 0.05), at(5.0, 0.1)]
    assert not beats(at(9.0, 0.1), usual)  # 11 % cheaper: within the spread of repeated runs
    assert not beats(at(10.0, 0.095), usual)


def test_worse_and_slower_settings_are_listed() -> None:
    before = report_of(at(10.0, 0.1, steps=1), at(10.0, 0.1, steps=2), at(0.1, 0.0, steps=3), at(5.0, 0.2, steps=4))
    now = report_of(at(11.4, 0.109, steps=1), at(11.6, 0.12, steps=2), at(0.9, 0.0, steps=3), at(5.0, 0.2, steps=5))
    found, words = compare(before, now)
    assert found == [
        "sum: steps=2: CPU ms 10 -> 11.6 (1.16 times)", "sum: steps=2: error 0.1 -> 0.12 (1.20 times)"
    ]  # fmt: skip
    assert words.startswith("3 settings compared, 2 regressions")
    assert found[0] in words
    assert not compare(now, before)[0]
    assert "(inf times)" in compare(report_of(at(1.0, 0.0)), report_of(at(1.0, 0.01)))[0][0]


def test_runs_that_differ_are_not_compared_in_silence() -> None:
    before = report_of(at(10.0, 0.1))
    other = report_of(at(10.0, 0.1), machine=MACHINE.model_copy(update={"device": "another", "load": 3.0}))
    _, notes = compare(before, other)
    assert "renderers differ (a device; now another)" in notes
    assert "the machine was busy in this run (load 3.0)" in notes
    with pytest.raises(ParameterError, match="got one with --quick, this one without"):
        compare(before, report_of(at(10.0, 0.1), quick=False))
    with pytest.raises(ParameterError, match="0 in common"):
        compare(before, report_of(at(10.0, 0.1, steps=9)))


def test_results_are_read_as_they_were_written(tmp_path: Path) -> None:
    report = report_of(at(1.0, 0.5), at(10.0, 0.1, "default"))
    path = tmp_path / "old.json"
    path.write_text(report.model_dump_json())
    assert read_report(path) == report
    for text in ("{", "[]", json.dumps({"format": 2}), report.model_dump_json().replace("cpu_ms", "cpu")):
        path.write_text(text)
        with pytest.raises(ParameterError, match=r"old\.json - is no result of bench"):
            read_report(path)
    with pytest.raises(ParameterError, match=r"gone\.json - "):
        read_report(tmp_path / "gone.json")


def test_the_page_needs_nothing_from_elsewhere_and_marks_the_default() -> None:
    found = at(1.0, 0.5), at(10.0, 0.1, "default", steps=2), at(8.0, 0.05, steps=3), at(90.0, 0.0, "reference", steps=4)
    report = report_of(*found)
    page = bench_page(report)
    assert not re.search(r"<script|https?://|url\(", page)
    assert "A &lt;sum&gt;" in page
    assert "Default off the front - sum: steps=3" in page
    drawing = ET.fromstring(re.search(r"<svg.*</svg>", pareto_plot(report.stages[0]))[0])
    assert len(drawing.findall("circle")) == len(found) + 2  # a ring for each of the two that are named
    assert {text.text for text in drawing.findall("text")} >= {"default", "reference"}
    dots = [(float(c.get("cx")), float(c.get("cy"))) for c in drawing.findall("circle")]
    assert all(0.0 < x < 900.0 and 0.0 < y < 360.0 for x, y in dots)
    pareto_plot(report_of(at(1.0, 0.0)).stages[0])  # a single setting has axes too
    narrow = pareto_plot(report_of(at(224.0, 0.1), at(346.0, 0.02)).stages[0])
    assert re.findall(r">(\d+) ms<", narrow) == ["300"]
    assert re.findall(r">(0\.\d+)<", narrow) == ["0.02", "0.05", "0.1"]


def test_stages_are_measured_at_the_defaults_of_scenes() -> None:
    assert list(STAGES) == ["light", "medium", "caustics", "planes", "shafts", "sun", "pixels", "frame"]
    fields = Scene.model_fields
    for stage in STAGES.values():
        for name, value in stage.named["default"].items():
            table, key = name.split(".")
            model = fields[table].default if table != "plate" else Scene.model_validate({"plate": "p.mp4"}).plate
            assert value == getattr(model, key), name
        assert {frozenset(p) for p in stage.settings(quick=False)} == {frozenset(stage.named["default"])}
        assert len(stage.settings(quick=True)) < len(stage.settings(quick=False))
    assert qualities("draw.samples")["draft"] == {"draw.samples": 13}


def test_a_real_stage_runs(tmp_path: Path) -> None:
    """Wavelengths of water: more of them are more accurate, and dearer."""

    def point(bands: int) -> dict[str, Any]:
        return {"water.mode": "table", "water.bands": bands}

    stage = replace(STAGES["medium"], quick=(point(3), point(31)), named={})
    bench = Workbench(tmp_path, Reference(), quick=True)
    few, many = measure(stage, bench)
    assert 0.0 < many.error < 0.2 * few.error
    assert 0.0 < few.cpu_ms < many.cpu_ms


def test_frames_of_the_dive_err_by_their_settings_alone(dive: SampleDive, tmp_path: Path) -> None:
    bench = Workbench(tmp_path, Reference(), quick=True)
    bench.runs, bench.scene_file = 1, dive.scene  # smaller than its own
    cheap = {"plate.scale": 0.25, "water.bands": 5, "light.smooth": "false", "shafts.mode": "off"}
    prepare, error = frames_against(bench, {**cheap, "draw.samples": 5})
    same, other = (error(prepare({**cheap, "draw.samples": count})(0)) for count in (5, 1))
    assert same == 0.0
    assert 1e-3 < other < 0.3


# --- the command ---------------------------------------------------------------------------------------------------


@pytest.fixture
def bench(
    run: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[int, str, str]]:
    """Run `mr360uw bench` with one fake stage; return exit code, output and errors."""
    monkeypatch.setattr("mr360uw.bench.bench_report.STAGES", {"sum": fake_stage([])})
    return partial(run, "bench", "--backend", "reference")


def test_the_command_prints_writes_and_compares(bench: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    old, page = tmp_path / "old.json", tmp_path / "page.html"
    code, out, err = bench("--only", "sum", "--json", old, "--page", page)
    assert (code, err) == (0, "")
    assert re.search(r"\* +0\.0 +0\.0 +0\.01  steps=100", out)
    assert page.read_text().startswith("<!doctype html>")
    code, _, err = bench("--json", old)
    assert code == 2
    assert "already there" in err
    code, out, _ = bench("--against", old)
    assert code == 0
    assert "3 settings compared, 0 regressions" in out
    before = read_report(old)
    found = tuple(replace(m, error=0.5 * m.error) for m in before.stages[0].measurements)
    stage = before.stages[0].model_copy(update={"measurements": found})
    old.write_text(before.model_copy(update={"stages": (stage,)}).model_dump_json())
    code, out, _ = bench("--against", old)
    assert code == 1
    assert "3 regressions" in out
    code, _, err = bench("--against", old, "--quick")
    assert code == 2
    assert "run alike" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--only", "fog"], "--only - no such stage (got fog) - take some of sum"),
        (["--against", "gone.json"], "gone.json - "),
        (["--json", "gone/out.json"], "folder is missing"),
    ],
)
def test_bad_input_is_reported_before_anything_is_measured(
    arguments: list[str], said: str, bench: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_report, "run_bench", lambda *_, **__: pytest.fail("was measured"))
    code, _, err = bench(*arguments)
    assert code == 2
    assert said in err
