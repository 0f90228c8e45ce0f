# SPDX-License-Identifier: Apache-2.0
"""A benchmark run and its results, as JSON and as a table, and what became slower or less accurate since another."""

from __future__ import annotations

import html
import math
import os
import platform
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from mr360uw.base.input_files import read_text
from mr360uw.base.progress import Progress, Steps, one_blas_thread
from mr360uw.bench.stages import STAGES, Knobs, MeasuredStage, Measurement, Workbench, measure
from mr360uw.errors import ParameterError, package_versions
from mr360uw.preview.pages import html_page
from mr360uw.render.frame import make_backend


def chosen_stages(only: Sequence[str]) -> list[MeasuredStage]:
    """Return the stages of some names, of all without any; raise `ParameterError` for names that none has."""
    if unknown := [name for name in only if name not in STAGES]:
        raise ParameterError(f"--only - no such stage (got {', '.join(unknown)}) - take some of {', '.join(STAGES)}")
    return [stage for name, stage in STAGES.items() if not only or name in only]


def run_bench(
    stages: Sequence[MeasuredStage], *, quick: bool = False, backend: str = "auto", progress: Progress | None = None
) -> BenchReport:
    """Measure stages on a sample dive made in a temporary folder; return the results.

    progress: called after every setting. Raises `GlError` or `ParameterError` for the backend.
    """
    from mr360uw import __version__

    renderer, _ = make_backend(backend)
    machine = _this_machine(renderer.name, renderer.device)
    steps = Steps(progress, sum(len(stage.settings(quick=quick)) for stage in stages))
    with tempfile.TemporaryDirectory() as folder, one_blas_thread():
        bench = Workbench(Path(folder), renderer, quick=quick)
        results = [StageResult.of(stage, measure(stage, bench, steps.done)) for stage in stages]
    return BenchReport(
        version=__version__, packages=package_versions(), machine=machine, quick=quick, stages=tuple(results)
    )


_CPU_INFO = Path("/proc/cpuinfo")


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Machine(_Frozen):
    """Machine of the figures. load: mean number of processes that wanted a core in the minute before."""

    cpu: str
    cores: int
    system: str
    backend: str
    device: str
    load: float

    @property
    def busy(self) -> bool:
        """Whether other programs may have disturbed the times: more than half of the cores were taken."""
        return self.load > 0.5 * self.cores


class StageResult(_Frozen):
    """Measurements of a stage. title, timed, truth: as in `stages.MeasuredStage`."""

    name: str
    title: str
    timed: str
    truth: str
    measurements: tuple[Measurement, ...]

    @classmethod
    def of(cls, stage: MeasuredStage, found: list[Measurement]) -> StageResult:
        """Return the result of a stage."""
        return cls(name=stage.name, title=stage.title, timed=stage.timed, truth=stage.truth, measurements=tuple(found))


class BenchReport(_Frozen):
    """Results of a run. format: of the file. quick: with fewer settings, smaller frames."""

    format: Literal[1] = 1
    version: str
    packages: dict[str, str]
    machine: Machine
    quick: bool
    stages: tuple[StageResult, ...]

    def __str__(self) -> str:
        return "\n".join(self._lines())

    @property
    def off_front(self) -> list[str]:
        """A line for each stage whose default another setting beats."""
        lines = []
        for stage in self.stages:
            if better := better_than_default(stage.measurements):
                usual = next(m for m in stage.measurements if "default" in m.names)
                lines.append(
                    f"{stage.name}: {knobs_in_words(better[0].knobs)} ({better[0].cpu_ms:.1f} ms, error "
                    f"{better[0].error:.2g}) beats the default ({usual.cpu_ms:.1f} ms, {usual.error:.2g})"
                )
        return lines

    def _lines(self) -> Iterator[str]:
        machine = self.machine
        yield f"mr360uw {self.version}, {machine.cpu}, {machine.cores} cores, {machine.backend}: {machine.device}"
        if machine.busy:
            yield f"note: the load average was {machine.load:.1f} at the start: times may be too long, errors are right"
        for stage in self.stages:
            yield f"\n{stage.name}: {stage.title}\n  time of {stage.timed}\n  error against {stage.truth}"
            yield f"  {'':2} {'CPU ms':>9} {'wall ms':>9} {'error':>9}"
            best = front(stage.measurements)
            for m in _by_time(stage):
                names = f"  ({', '.join(m.names)})" if m.names else ""
                mark = "*" if m in best else ""
                yield (f"  {mark:2} {m.cpu_ms:9.1f} {m.wall_ms:9.1f} {m.error:9.2g}  {knobs_in_words(m.knobs)}{names}")
        yield "\n* no other setting is cheaper and as accurate, or more accurate and as cheap (see docs/benchmarks.md)"
        yield from (f"default off the front - {line}" for line in self.off_front)


def read_report(path: Path) -> BenchReport:
    """Return the results that a run wrote as JSON; raise `ParameterError` where the file holds none."""
    try:
        return BenchReport.model_validate_json(read_text(path, ParameterError))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise ParameterError(
            f"{path} - is no result of bench (got, at {where}: {first['msg']}) - name a file that --json wrote"
        ) from None


def _this_machine(backend: str, device: str) -> Machine:
    """Return the machine that this runs on. backend, device: of the renderer."""
    system, load = f"{platform.system()} {platform.release()}", os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Machine(cpu=_processor(), cores=cores, system=system, backend=backend, device=device, load=round(load, 2))


def _processor() -> str:
    lines = _CPU_INFO.read_text("utf-8", errors="replace").splitlines() if _CPU_INFO.is_file() else []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()


_LEAST_MS = 1.0
"""Difference of time [ms] below which nothing counts as slower: the clock and the caches of the processor."""


def check_kinds(before: BenchReport, *, quick: bool) -> None:
    """Raise `ParameterError` where an earlier run is not of the kind of one that is `quick` or not."""
    if before.quick != quick:
        kinds = ["with --quick" if one else "without --quick" for one in (before.quick, quick)]
        raise ParameterError(f"--against - the runs differ (got one {kinds[0]}, this one {kinds[1]}) - run alike")


SLOWER, WORSE = 1.15, 1.10
"""Ratios of time and of error from which on a setting counts as slower or worse than another. Medians of five runs on a
quiet machine repeat within about 5 %; errors repeat exactly but for changes of the code."""


_TINY_ERROR = 1e-6
"""Relative error below which differences are rounding."""


def beats(one: Measurement, other: Measurement) -> bool:
    """Return whether a setting is cheaper than another and no less accurate, or more accurate and no dearer.

    Differences within `SLOWER` and `WORSE` count as none.
    """
    cheaper, dearer = one.cpu_ms * SLOWER < other.cpu_ms, one.cpu_ms > other.cpu_ms
    better, worse = larger(other.error, one.error), one.error > other.error + _TINY_ERROR
    return (cheaper and not worse) or (better and not dearer)


def larger(error: float, before: float) -> bool:
    """Return whether an error is larger than another by more than `WORSE` and by more than rounding."""
    return error > WORSE * before and error - before > _TINY_ERROR


def front(found: Sequence[Measurement]) -> list[Measurement]:
    """Return the settings that no other one beats, the cheapest first."""
    return sorted((m for m in found if not any(beats(o, m) for o in found)), key=lambda m: m.cpu_ms)


def better_than_default(found: Sequence[Measurement]) -> list[Measurement]:
    """Return the settings that beat the default, the most accurate first; none where it lies on the front."""
    usual = next((m for m in found if "default" in m.names), None)
    return [] if usual is None else sorted((m for m in found if beats(m, usual)), key=lambda m: (m.error, m.cpu_ms))


def knobs_in_words(knobs: Knobs) -> str:
    """Return settings as text: caustics.size=512 caustics.grid=auto."""
    return " ".join(f"{name}={'auto' if value is None else value}" for name, value in knobs.items())


def compare(before: BenchReport, now: BenchReport) -> tuple[list[str], str]:
    """Return a line for each setting that became worse, and the comparison in words; raise `ParameterError` for runs
    of different kinds or without a common setting.

    Slower: processor time more than 1.15 times and 1 ms longer. Less accurate: error more than 1.1 times larger.
    """
    check_kinds(before, quick=now.quick)
    old = {_key(stage.name, m): m for stage in before.stages for m in stage.measurements}
    found: list[str] = []
    compared = 0
    for stage in now.stages:
        for m in stage.measurements:
            was = old.get(_key(stage.name, m))
            if was is None:
                continue
            compared += 1
            if m.cpu_ms > SLOWER * was.cpu_ms and m.cpu_ms - was.cpu_ms > _LEAST_MS:
                found.append(_worse(_key(stage.name, m), "CPU ms", was.cpu_ms, m.cpu_ms))
            if larger(m.error, was.error):
                found.append(_worse(_key(stage.name, m), "error", was.error, m.error))
    if not compared:
        raise ParameterError("--against - has none of the settings of this run (got 0 in common) - run the same stages")
    head = f"{compared} settings compared, {len(found)} regressions (time > {SLOWER:g} times, error > {WORSE:g} times)"
    return found, "\n".join((head, *found, *_notes(before, now)))


def _worse(setting: str, quantity: str, before: float, now: float) -> str:
    ratio = now / before if before > 0.0 else float("inf")
    return f"{setting}: {quantity} {before:.3g} -> {now:.3g} ({ratio:.2f} times)"


def _key(stage: str, m: Measurement) -> str:
    return f"{stage}: {knobs_in_words(m.knobs)}"


def _notes(before: BenchReport, now: BenchReport) -> tuple[str, ...]:
    notes = []
    for name, was, is_ in (
        ("processors", before.machine.cpu, now.machine.cpu),
        ("numbers of cores", before.machine.cores, now.machine.cores),
        ("renderers", before.machine.device, now.machine.device),
    ):
        if was != is_:
            notes.append(f"note: the {name} differ ({was}; now {is_}): times are not comparable")
    for word, run in (("the earlier", before), ("this", now)):
        if run.machine.busy:
            notes.append(f"note: the machine was busy in {word} run (load {run.machine.load:.1f})")
    return tuple(notes)


# A self-contained HTML page of a benchmark run: error over processor time of each stage, with its Pareto front.

_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _EDGE = 900, 360, 70, 44, 26


_BELOW = 0.3
"""Place of exact settings, in units of the smallest error that is not 0: below the others, and near enough to them."""


_FRONT, _OTHER = "#0b6e99", "#9aa7b2"


_COLOURS = {"default": "#c2410c", "draft": "#4d7c0f", "reference": "#6d28d9"}


_STYLE = """
text { paint-order: stroke; stroke: #fff; stroke-width: 3px; stroke-linejoin: round; }
td.n { text-align: right; font-variant-numeric: tabular-nums; } tr.front { font-weight: 600; }
circle:hover { stroke: #16202a; stroke-width: 2; } .note { color: #c2410c; }
"""


Place = Callable[[float], float]


def bench_page(report: BenchReport) -> str:
    """Return the page of a run as one HTML string, readable offline."""
    # Say what was measured where
    machine = report.machine
    where = f"{machine.cpu}, {machine.cores} cores, {machine.system}; renderer {machine.backend}: {machine.device}"
    kind = "; a quick run" if report.quick else ""
    head = html.escape(f"mr360uw {report.version}; {where}{kind}")
    parts = ["<h1>What settings cost and bring</h1>", f"<p>{head}</p>"]
    if machine.busy:
        parts.append(
            f'<p class="note">The load average was {machine.load:.1f} at the start: times may be too long.</p>'
        )
    # Explain the plots, then show plot and table of each stage
    legend = ", ".join(f'<span style="color:{colour}">{name}</span>' for name, colour in _COLOURS.items())
    parts.append(
        "<p>Each dot is a setting: right is dearer, up is less accurate, both in powers of ten. Blue dots on the line "
        "are the Pareto front: no other setting is both cheaper and as accurate. Rings are the settings that "
        f"<code>draw.quality</code> stands for: {legend}. Numbers are the rows of the table below each plot.</p>"
    )
    parts += [f'<p class="note">Default off the front - {html.escape(line)}</p>' for line in report.off_front]
    for stage in report.stages:
        words = f"<p>Time: {html.escape(stage.timed)}. Error: against {html.escape(stage.truth)}.</p>"
        parts += [f"<h2>{html.escape(stage.title)}</h2>", words, pareto_plot(stage), _table(stage)]
    versions = ", ".join(f"{name} {version}" for name, version in report.packages.items() if version)
    return html_page("mr360uw bench", [*parts, f"<p>{html.escape(versions)}</p>"], _STYLE)


def pareto_plot(stage: StageResult) -> str:
    """Return an inline SVG of error over processor time, both logarithmic, with front and named settings."""
    # Place all measurements on logarithmic axes
    found, best = _by_time(stage), front(stage.measurements)
    least = _BELOW * min((m.error for m in found if m.error > 0.0), default=1.0)
    times, errors = [max(m.cpu_ms, 1e-3) for m in found], [max(m.error, least) for m in found]
    x = _axis(times, _LEFT + _EDGE, _WIDTH - _EDGE)
    y = _axis(errors, _HEIGHT - _BOTTOM - _EDGE, _EDGE)
    label = html.escape(f"{stage.title}: relative error over CPU time in ms")
    out = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{label}" font-size="11">']
    # Draw the grid and its figures; an exact setting stands at the lowest error
    for value in _ticks(times):
        at = x(value)
        out.append(f'<path d="M{at:.1f} {_EDGE}V{_HEIGHT - _BOTTOM}" stroke="#e3e9ee"/>')
        out.append(f'<text x="{at:.1f}" y="{_HEIGHT - _BOTTOM + 16}" text-anchor="middle">{value:g} ms</text>')
    exact = min(m.error for m in found) == 0.0
    marks = {value: f"{value:.3g}" for value in _ticks(errors) if value > 1.5 * least or not exact}
    for value, word in (marks | ({least: "0"} if exact else {})).items():
        at = y(value)
        out.append(f'<path d="M{_LEFT} {at:.1f}H{_WIDTH - _EDGE}" stroke="#e3e9ee"/>')
        out.append(f'<text x="{_LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{word}</text>')
    # Draw the axes, the front, and a dot for each setting
    bottom = _HEIGHT - _BOTTOM
    out.append(f'<path d="M{_LEFT} {_EDGE / 2}V{bottom}H{_WIDTH - _EDGE / 2}" fill="none" stroke="{_OTHER}"/>')
    places = {id(m): (x(time), y(error)) for m, time, error in zip(found, times, errors, strict=True)}
    line = "L".join("{:.1f} {:.1f}".format(*places[id(m)]) for m in best)
    out.append(f'<path d="M{line}" fill="none" stroke="{_FRONT}" stroke-width="1.6"/>')
    out += [_dot(m, row, *places[id(m)], on_front=m in best) for row, m in enumerate(found, 1)]
    out.append(f'<text x="{_WIDTH - _EDGE}" y="{_HEIGHT - 6}" text-anchor="end">CPU time of one run</text>')
    out.append(f'<text x="{_LEFT}" y="{_HEIGHT - 6}">relative error (up) against the truth</text></svg>')
    return f"<figure>{''.join(out)}</figure>"


def _by_time(stage: StageResult) -> list[Measurement]:
    """Return the measurements in the order of the table's rows, the cheapest first."""
    return sorted(stage.measurements, key=lambda m: m.cpu_ms)


def _dot(m: Measurement, row: int, x: float, y: float, *, on_front: bool) -> str:
    words = html.escape(f"{knobs_in_words(m.knobs)}: {m.cpu_ms:.1f} ms, error {m.error:.2g}")
    fill = _FRONT if on_front else _OTHER
    dot = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{fill}"><title>{words}</title></circle>'
    for ring, name in enumerate(m.names):
        radius = 8 + 4 * ring
        dot += (
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="none" stroke="{_COLOURS[name]}" stroke-width="2"/>'
        )
    dot += f'<text x="{x:.1f}" y="{y + 19:.1f}" text-anchor="middle" fill="#5b6872">{row}</text>'
    if m.names:
        side, anchor = (-12, "end") if x > 0.8 * _WIDTH else (12, "start")
        text = html.escape(", ".join(m.names))
        dot += f'<text x="{x + side:.1f}" y="{y - 8:.1f}" text-anchor="{anchor}">{text}</text>'
    return dot


def _axis(values: Sequence[float], first: float, last: float) -> Place:
    """Return the place of a value between two edges of a picture, by its logarithm."""
    low, high = math.log10(min(values)), math.log10(max(values))
    span = max(high - low, 1e-9)
    return lambda value: first + (last - first) * (math.log10(value) - low) / span


def _ticks(values: Sequence[float]) -> list[float]:
    """Return round numbers within the range of values: 1, 2, 5 times powers of ten, or even steps in a narrow range."""
    low, high = min(values), max(values)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    inside = [d * 10.0**power for power in powers for d in (1, 2, 5) if low <= d * 10.0**power <= high]
    tens = [10.0**power for power in powers if low <= 10.0**power <= high]
    if len(tens) >= 3 or len(inside) >= 3 or high <= low:
        return (tens if len(tens) >= 3 else inside) or [low]
    step = 10.0 ** math.floor(math.log10(high - low))
    return [n * step for n in range(math.ceil(low / step), math.floor(high / step) + 1)] or [low]


def _table(stage: StageResult) -> str:
    best, rows = front(stage.measurements), []
    for row, m in enumerate(_by_time(stage), 1):
        cells = "".join(
            f'<td class="n">{value}</td>' for value in (row, f"{m.cpu_ms:.1f}", f"{m.wall_ms:.1f}", f"{m.error:.2g}")
        )
        names = f" ({', '.join(m.names)})" if m.names else ""
        knobs = html.escape(knobs_in_words(m.knobs) + names)
        rows.append(f"<tr{' class=front' if m in best else ''}>{cells}<td>{knobs}</td></tr>")
    head = "<tr><th></th><th>CPU ms</th><th>wall ms</th><th>error</th><th>settings</th></tr>"
    return f"<details open><summary>Figures</summary><table>{head}{''.join(rows)}</table></details>"
