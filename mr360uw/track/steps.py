# SPDX-License-Identifier: Apache-2.0
"""Progress of a track, in units of the time that one frame takes to be read."""

from __future__ import annotations

from mr360uw.progress import Progress

FEATURES, PAIR, MAPPED, BETWEEN = 10, 4, 6, 2
"""Cost of a key frame's features, a matched pair, a key frame in the map, a frame between: over reading a frame."""


class Steps:
    """Counts the steps of a run and passes them on; more are expected as key frames are found."""

    def __init__(self, progress: Progress | None, expected: int) -> None:
        self._progress, self._done, self._expected = progress, 0, expected

    def expect(self, count: int) -> None:
        """Expect that many more steps."""
        self._expected += count

    def done(self, count: int = 1) -> None:
        """Count steps as done."""
        self._done += count
        if self._progress is not None:
            self._progress(self._done, max(self._expected, self._done))
