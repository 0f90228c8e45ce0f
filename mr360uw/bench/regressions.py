# SPDX-License-Identifier: Apache-2.0
"""Comparison of two benchmark runs: which settings became slower or less accurate."""

from __future__ import annotations

from dataclasses import dataclass

from mr360uw.bench.bench_report import BenchReport
from mr360uw.bench.measuring import SLOWER, WORSE, Knobs, Measurement, knobs_in_words, larger
from mr360uw.errors import ParameterError

_LEAST_MS = 1.0
"""Difference of time [ms] below which nothing counts as slower: the clock and the caches of the processor."""


@dataclass(frozen=True, slots=True)
class Regression:
    """A setting that is slower or less accurate than it was. ratio: of now over before."""

    stage: str
    knobs: Knobs
    quantity: str
    before: float
    now: float

    @property
    def ratio(self) -> float:
        """Now over before."""
        return self.now / self.before if self.before > 0.0 else float("inf")

    def __str__(self) -> str:
        return (
            f"{self.stage}: {knobs_in_words(self.knobs)}: {self.quantity} {self.before:.3g} -> {self.now:.3g} "
            f"({self.ratio:.2f} times)"
        )


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two runs compared. compared: settings that both have. notes: why their times may differ for other reasons."""

    regressions: tuple[Regression, ...]
    compared: int
    notes: tuple[str, ...]

    def __str__(self) -> str:
        head = f"{self.compared} settings compared, {len(self.regressions)} regressions (time > {SLOWER:g} times, "
        return "\n".join((head + f"error > {WORSE:g} times)", *map(str, self.regressions), *self.notes))


def check_kinds(before: BenchReport, *, quick: bool) -> None:
    """Raise `ParameterError` where an earlier run is not of the kind of one that is `quick` or not."""
    if before.quick != quick:
        kinds = ["with --quick" if one else "without --quick" for one in (before.quick, quick)]
        raise ParameterError(f"--against - the runs differ (got one {kinds[0]}, this one {kinds[1]}) - run alike")


def compare(before: BenchReport, now: BenchReport) -> Comparison:
    """Return what became worse; raise `ParameterError` for runs of different kinds or without a common setting.

    Slower: processor time more than 1.15 times and 1 ms longer. Less accurate: error more than 1.1 times larger.
    """
    check_kinds(before, quick=now.quick)
    old = {_key(stage.name, m): m for stage in before.stages for m in stage.measurements}
    found: list[Regression] = []
    compared = 0
    for stage in now.stages:
        for m in stage.measurements:
            was = old.get(_key(stage.name, m))
            if was is None:
                continue
            compared += 1
            if m.cpu_ms > SLOWER * was.cpu_ms and m.cpu_ms - was.cpu_ms > _LEAST_MS:
                found.append(Regression(stage.name, m.knobs, "CPU ms", was.cpu_ms, m.cpu_ms))
            if larger(m.error, was.error):
                found.append(Regression(stage.name, m.knobs, "error", was.error, m.error))
    if not compared:
        raise ParameterError("--against - has none of the settings of this run (got 0 in common) - run the same stages")
    return Comparison(tuple(found), compared, _notes(before, now))


def _key(stage: str, m: Measurement) -> str:
    return f"{stage} {knobs_in_words(m.knobs)}"


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
