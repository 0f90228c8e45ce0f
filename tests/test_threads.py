# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from mr360uw.steps import Pause, Steps
from mr360uw.threads import Behind, in_flight, prefetch


def test_prefetch_keeps_order_and_runs_ahead_no_further_than_its_depth() -> None:
    taken: list[int] = []

    def source() -> Iterator[int]:
        for k in range(50):
            taken.append(k)
            yield k

    got = []
    for item in prefetch(source(), depth=3):
        got.append(item)
        time.sleep(0.001)
        assert len(taken) <= item + 3 + 2
    assert got == list(range(50))


def test_prefetch_raises_the_source_s_error_here() -> None:
    def source() -> Iterator[int]:
        yield 1
        raise OSError("disk")

    items = prefetch(source())
    assert next(items) == 1
    with pytest.raises(OSError, match="disk"):
        next(items)


def test_leaving_prefetch_early_stops_its_thread() -> None:
    before = threading.active_count()
    items = prefetch(iter(range(10**9)), depth=2)
    assert next(items) == 0
    items.close()
    assert threading.active_count() == before


def test_behind_keeps_order_and_finishes_before_leaving() -> None:
    got: list[int] = []
    with Behind(got.append, depth=2) as behind:
        for k in range(100):
            behind.put(k)
    assert got == list(range(100))


def test_the_last_call_of_behind_is_on_its_thread_whatever_the_work_raised() -> None:
    threads: list[threading.Thread] = []

    def work(item: int) -> None:
        threads.append(threading.current_thread())
        if item:
            raise OSError("full")

    for items in ([0], [0, 1]):
        del threads[:]
        try:
            with Behind(work, last=lambda: threads.append(threading.current_thread())) as behind:
                for item in items:
                    behind.put(item)
        except OSError:
            assert items == [0, 1]
        assert len(threads) == len(items) + 1
        assert len(set(threads)) == 1


def test_behind_raises_what_the_work_raised_and_does_not_hang() -> None:
    def work(item: int) -> None:
        if item == 3:
            raise OSError("full")

    with pytest.raises(OSError, match="full"), Behind(work, depth=1) as behind:
        for k in range(1000):
            behind.put(k)


def test_an_error_of_the_caller_comes_first() -> None:
    with pytest.raises(KeyError), Behind(lambda _item: None) as behind:
        behind.put(1)
        raise KeyError


def counting_steps(name: int, log: list[tuple[str, int, str]]) -> Steps[int]:
    for pause in (Pause.DEVICE, Pause.ANSWER, Pause.DEVICE, Pause.ANSWER, Pause.DEVICE, Pause.REST):
        log.append((threading.current_thread().name, name, pause.value))
        yield pause
    if name == 7:
        raise OSError("seventh")
    return name


@pytest.mark.parametrize("depth", [0, 1, 2, 4])
def test_steps_in_flight_come_in_order_and_draw_on_the_caller_s_thread(depth: int) -> None:
    log: list[tuple[str, int, str]] = []
    answers = 0

    def answer() -> None:
        nonlocal answers
        answers += 1

    got = list(in_flight((counting_steps(k, log) for k in range(6)), answer, depth))
    assert got == list(range(6))
    here = threading.current_thread().name
    drawn = {name for name, _, what in log if what in ("answer", "rest")}  # what comes before these pauses
    assert drawn == {here}
    if depth:
        assert here not in {name for name, _, what in log if what == "device"}
    if depth == 4:
        assert answers <= 6 + 4  # three for each, were they not together


@pytest.mark.parametrize("depth", [0, 3])
def test_an_error_in_flight_comes_after_all_that_is_before_it(depth: int) -> None:
    def frames(stop: int) -> Iterator[Steps[int]]:
        for k in range(stop):
            yield counting_steps(k, [])
        raise OSError("source")

    for stop, message in ((9, "seventh"), (5, "source")):
        flown: list[int] = []
        with pytest.raises(OSError, match=message):
            flown.extend(map(abs, in_flight(frames(stop), lambda: None, depth)))
        assert flown == list(range(min(stop, 7)))


def test_leaving_flight_early_ends_its_threads() -> None:
    before = threading.active_count()
    flight = in_flight((counting_steps(k, []) for k in range(100)), lambda: None, 3)
    assert next(flight) == 0
    flight.close()
    assert threading.active_count() == before
