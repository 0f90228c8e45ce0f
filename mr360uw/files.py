# SPDX-License-Identifier: Apache-2.0
"""Small files that appear whole or not at all."""

from __future__ import annotations

from pathlib import Path


def write_whole(path: Path, data: str | bytes) -> None:
    """Write a file under a temporary name and rename it; on failure nothing is left, and `OSError` names the file."""
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_bytes(data.encode() if isinstance(data, str) else data)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
