# SPDX-License-Identifier: Apache-2.0
"""The notebooks of the documentation run from top to bottom, and stand there with their results."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_runs(path: Path, tmp_path: Path) -> None:
    """Its cells as one program in a process of its own; what a cell shows besides its figures is thrown away.

    A dive of its own is made smaller, which takes a fifth of the time.
    """
    cells = [cell for cell in json.loads(path.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]
    said = [output for cell in cells for output in cell["outputs"] if output["output_type"] == "stream"]
    assert said
    assert all(output["name"] == "stdout" for output in said), "a warning stands in the page"
    assert any("image/png" in output.get("data", {}) for cell in cells for output in cell["outputs"])
    program = tmp_path / "cells.py"
    source = "\n\n".join("".join(cell["source"]) for cell in cells)
    assert ("uw.sample_dive(" in source) == ("width=384" in source)
    program.write_text(source.replace("width=384", "width=128"), "utf-8")
    ours = {**os.environ, "MPLBACKEND": "agg"}
    done = subprocess.run([sys.executable, program], cwd=tmp_path, env=ours, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] in "".join(said[0]["text"])


def test_there_are_notebooks_of_the_three_uses() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["a_whole_composite", "caustics_over_depth_and_wind", "light_of_a_dive"]
