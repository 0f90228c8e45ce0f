# SPDX-License-Identifier: Apache-2.0
"""The choice of the processes that render."""

from __future__ import annotations

import os
from typing import Literal

from mr360uw.errors import ParameterError
from mr360uw.farm.cluster import ClusterCrew
from mr360uw.farm.job import Crew
from mr360uw.farm.workers import WorkerCrew


def make_crew(workers: int | Literal["auto"], cluster: str | None, parts: int) -> Crew | None:
    """Return the processes that render `parts` parts, or None for this one alone.

    workers: their number; "auto" takes one for every two cores. cluster: address of a Dask scheduler instead.
    """
    if cluster is not None:
        return ClusterCrew.at(cluster)
    if workers != "auto" and (isinstance(workers, bool) or not isinstance(workers, int) or workers < 1):
        raise ParameterError(f"workers - must be a number of processes or auto (got {workers!r}) - give 1 or more")
    count = max(1, (os.cpu_count() or 2) // 2) if workers == "auto" else workers
    if min(count, parts) == 1:
        return None
    return WorkerCrew(min(count, parts))
