# SPDX-License-Identifier: Apache-2.0
"""A benchmark run: measures stages, writes its results and compares them with earlier ones."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from mr360uw.bench.bench_report import BenchReport, StageResult, this_machine
from mr360uw.bench.measuring import MeasuredStage, measure
from mr360uw.bench.workbench import Workbench
from mr360uw.errors import ParameterError
from mr360uw.info import package_versions
from mr360uw.progress import Progress
from mr360uw.render.backends import make_backend
from mr360uw.threads import one_blas_thread


def chosen_stages(only: Sequence[str]) -> list[MeasuredStage]:
    """Return the stages of some names, of all without any; raise `ParameterError` for names that none has."""
    from mr360uw.bench.stages import all_stages

    stages = all_stages()
    if unknown := [name for name in only if name not in stages]:
        raise ParameterError(f"--only - no such stage (got {', '.join(unknown)}) - take some of {', '.join(stages)}")
    return [stage for name, stage in stages.items() if not only or name in only]


def run_bench(
    stages: Sequence[MeasuredStage], *, quick: bool = False, backend: str = "auto", progress: Progress | None = None
) -> BenchReport:
    """Measure stages on a sample dive made in a temporary folder; return the results.

    progress: called after every setting. Raises `GlError` or `ParameterError` for the backend.
    """
    from mr360uw import __version__

    renderer, _ = make_backend(backend)
    machine = this_machine(renderer.name, renderer.device)
    total, done, results = sum(len(stage.settings(quick=quick)) for stage in stages), 0, []

    def tick() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    with tempfile.TemporaryDirectory() as folder, one_blas_thread():
        bench = Workbench(Path(folder), renderer, quick=quick)
        results = [StageResult.of(stage, measure(stage, bench, tick)) for stage in stages]
    return BenchReport(
        version=__version__, packages=package_versions(), machine=machine, quick=quick, stages=tuple(results)
    )
