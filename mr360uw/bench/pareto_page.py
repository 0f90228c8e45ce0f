# SPDX-License-Identifier: Apache-2.0
"""A self-contained HTML page of a benchmark run: error over processor time of each stage, with its Pareto front."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence

from mr360uw.bench.bench_report import BenchReport, StageResult
from mr360uw.bench.measuring import Measurement, front, knobs_in_words
from mr360uw.ibl.report import html_page

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
    machine = report.machine
    where = f"{machine.cpu}, {machine.cores} cores, {machine.system}; renderer {machine.backend}: {machine.device}"
    kind = "; a quick run" if report.quick else ""
    head = html.escape(f"mr360uw {report.version}; {where}{kind}")
    parts = ["<h1>What settings cost and bring</h1>", f"<p>{head}</p>"]
    if machine.busy:
        parts.append(
            f'<p class="note">The load average was {machine.load:.1f} at the start: times may be too long.</p>'
        )
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
    found, best = _by_time(stage), front(stage.measurements)
    least = _BELOW * min((m.error for m in found if m.error > 0.0), default=1.0)
    times, errors = [max(m.cpu_ms, 1e-3) for m in found], [max(m.error, least) for m in found]
    x = _axis(times, _LEFT + _EDGE, _WIDTH - _EDGE)
    y = _axis(errors, _HEIGHT - _BOTTOM - _EDGE, _EDGE)
    label = html.escape(f"{stage.title}: relative error over CPU time in ms")
    out = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{label}" font-size="11">']
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
