# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from mr360uw.base.progress import Behind, prefetch


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
