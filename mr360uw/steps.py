# SPDX-License-Identifier: Apache-2.0
"""Work in steps: functions that pause where they go from the processor to the device and back.

What is between two pauses needs one of the two alone. So a frame may be worked on by several threads, one after the
other, of which one alone talks to the device, and several frames may wait for the device together
(`threads.in_flight`). Run straight through on one thread (`finished`), the result is the same.
"""

from __future__ import annotations

from collections.abc import Generator
from enum import Enum
from typing import Any, TypeVar

T = TypeVar("T")


class Pause(Enum):
    """What a function in steps needs in order to go on.

    DEVICE: the device's own thread. ANSWER: what has been sent so far must be back from the device; from here on any
    thread will do, and the device is needed again soon. REST: as ANSWER, but the device is needed no more, or after
    long work.
    """

    DEVICE = "device"
    ANSWER = "answer"
    REST = "rest"


Steps = Generator[Pause, None, T]
"""A function in steps; at its end it returns. It begins on any thread."""


def side_by_side(*parts: Steps[Any]) -> Steps[list[Any]]:
    """Return the results of several steps. None of them waits for an answer before all have asked."""
    results: list[Any] = [None] * len(parts)
    working, due = dict(enumerate(parts)), list(range(len(parts)))
    pauses: dict[int, Pause] = {}
    while True:
        for number in due:
            try:
                pauses[number] = next(working[number])
            except StopIteration as done:
                results[number] = done.value
                del working[number]
                pauses.pop(number, None)
        if not working:
            return results
        now = next(pause for pause in Pause if pause in pauses.values())
        yield now
        due = [number for number, pause in pauses.items() if pause is now]


def finished(steps: Steps[T]) -> T:
    """Return the result of steps, which all run here."""
    while True:
        try:
            next(steps)
        except StopIteration as done:
            result: T = done.value
            return result
