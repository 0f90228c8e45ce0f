# SPDX-License-Identifier: Apache-2.0
"""Processor time and peak memory of this process."""

from __future__ import annotations

import resource
from pathlib import Path


def processor_s() -> float:
    """Return the processor time [s] of this process and of its children that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def peak_kib() -> int:
    """Return the peak of this process's resident memory [KiB].

    On Linux from the process itself: `ru_maxrss` would count what the parent held before the child began.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
