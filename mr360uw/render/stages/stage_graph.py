# SPDX-License-Identifier: Apache-2.0
"""Graph of the stages of a frame, as they ran: whose results each stage took, and the processor time of each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, TypeVar, TypeVarTuple

from mr360uw.cache import Cache, PartOf, name_of

T = TypeVar("T")
Inputs = TypeVarTuple("Inputs")

_DEPTH = 3
"""Levels of fields in which an input is looked for results of other stages: a body's mesh is in its place in a shot."""
_LEAST_MS = 0.05
"""Processor time [ms] below which a stage is left out of the table, for nobody would miss it."""


@dataclass
class StageRun:
    """A stage: how often it was asked for and how often it ran, its processor time [s] without that of the stages that
    it called, and the stages whose results it took.
    """

    asked: int = 0
    ran: int = 0
    seconds: float = 0.0
    inputs: set[str] = field(default_factory=set)


class StageGraph(Cache):
    """A cache that notes the graph of the functions whose results it holds. runs: by name, in the order of their ends.

    Caches of other parts of the program may note into the same graph. graph: that they note into; None for an own one.
    """

    def __init__(self, room: int = 1, graph: StageGraph | None = None) -> None:
        super().__init__(room)
        self.runs: dict[str, StageRun] = {} if graph is None else graph.runs
        self._within: list[float] = [] if graph is None else graph._within
        self._makers: dict[int, tuple[str, object]] = {} if graph is None else graph._makers

    def of(self, function: Callable[[*Inputs], T], *inputs: *Inputs, keep: int = 1) -> T:
        """Return the result of a function, as `Cache.of` does."""
        name, before = name_of(function), self.made.total()
        self._within.append(0.0)
        began = time.process_time()
        result = super().of(function, *inputs, keep=keep)
        took = time.process_time() - began
        own = took - self._within.pop()
        if self._within:
            self._within[-1] += took
        run = self.runs.setdefault(name, StageRun())
        run.asked += 1
        ran = self.made.total() > before
        run.ran += ran
        run.seconds += own
        if ran:  # a result that is there has noted its inputs
            makers = (self._makers.get(id(part)) for part in _parts(inputs, _DEPTH))
            run.inputs |= {maker[0] for maker in makers if maker is not None} - {name}
        for part in (result, *(result if isinstance(result, tuple) else ())):
            self._makers.setdefault(id(part), (name, part))  # holds the part, so that its number is not given again
        return result

    def forget_times(self) -> None:
        """Begin anew to count, and let go of results; which stages took whose results stays known."""
        self._makers.clear()
        for run in self.runs.values():
            run.asked = run.ran = 0
            run.seconds = 0.0

    def __str__(self) -> str:
        shown = {name: run for name, run in self.runs.items() if 1e3 * run.seconds >= _LEAST_MS}
        width = max(map(len, shown), default=0)
        return "\n".join(
            f"  {name:<{width}}  {1e3 * run.seconds:8.1f} ms  {run.ran} of {run.asked}  {', '.join(sorted(run.inputs))}"
            for name, run in shown.items()
        )


def _parts(item: Any, depth: int) -> Iterator[object]:
    """Yield an input and its fields, down to a depth."""
    if item is None or isinstance(item, int | float | str):
        return
    yield item
    if depth == 0:
        return
    if isinstance(item, PartOf):
        yield from _parts(item.whole, depth)
    elif isinstance(item, tuple | list):
        for part in item:
            yield from _parts(part, depth)
    elif is_dataclass(item):
        for one in fields(item):
            yield from _parts(getattr(item, one.name, None), depth - 1)
