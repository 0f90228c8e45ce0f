# SPDX-License-Identifier: Apache-2.0
"""Reference values that were computed without this package; tests/data/README.md says how."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).with_name("data")


def reference_rows(name: str) -> list[dict[str, str]]:
    """Return the rows of a table, by the names of its columns."""
    with (FOLDER / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def reference_arrays(name: str) -> dict[str, np.ndarray]:
    """Return the arrays of an .npz file by name."""
    with np.load(FOLDER / name) as file:
        return {key: file[key] for key in file.files}
