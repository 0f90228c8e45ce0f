# SPDX-License-Identifier: Apache-2.0
"""The command that measures what settings cost and bring on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mr360uw.cli.arguments import BackendOption, OverwriteOption
from mr360uw.cli.gated import Role

_REGRESSED = 1
"""Exit code of a comparison that found something slower or less accurate."""


def bench(
    quick: Annotated[
        bool, typer.Option("--quick", help="fewer settings and smaller frames: about two minutes")
    ] = False,
    only: Annotated[list[str] | None, typer.Option(help="measure this stage alone; may be repeated")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="also write every measurement, as JSON"), Role.WRITTEN
    ] = None,
    page: Annotated[
        Path | None, typer.Option(help="also write a page with the Pareto fronts, as HTML"), Role.WRITTEN
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(help="JSON of an earlier run: list what is slower or worse, exit code 1 if any"),
        Role.READ,
    ] = None,
    backend: BackendOption = "auto",
    overwrite: OverwriteOption = False,
) -> None:
    """Measure what settings cost (processor time) and bring (error), stage by stage, on a sample dive."""
    from mr360uw.bench.bench_report import chosen_stages, read_report, run_bench
    from mr360uw.bench.pareto_page import bench_page
    from mr360uw.bench.regressions import check_kinds, compare
    from mr360uw.files import write_whole
    from mr360uw.progress import terminal_progress

    del overwrite  # the outputs have been looked at: see `gated`
    stages, before = chosen_stages(only or ()), None if against is None else read_report(against)
    if before is not None:
        check_kinds(before, quick=quick)
    with terminal_progress() as progress:
        report = run_bench(stages, quick=quick, backend=backend, progress=progress)
    typer.echo(str(report))
    if json_file is not None:
        write_whole(json_file, report.model_dump_json(indent=2) + "\n")
    if page is not None:
        write_whole(page, bench_page(report))
    if before is not None:
        comparison = compare(before, report)
        typer.echo(f"\nagainst {against}: {comparison}")
        if comparison.regressions:
            raise typer.Exit(_REGRESSED)
