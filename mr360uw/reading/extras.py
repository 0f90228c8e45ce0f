# SPDX-License-Identifier: Apache-2.0
"""Packages that are not installed by default: the extras of pyproject.toml, by the word in brackets."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

EXTRAS = {
    "data": ("xarray",),
    "farm": ("distributed",),
    "gltf": ("DracoPy", "meshopt"),
    "notebook": ("ipywidgets", "tomlkit"),
    "ocio": ("opencolorio",),
    "plot": ("matplotlib",),
    "track": ("pycolmap",),
    "tune": ("nicegui", "tomlkit"),
    "usd": ("usd-core",),
}
"""Packages of each extra that a part of the toolkit needs, by the names with which pip installs them."""


def command(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install 'mr360uw[{extra}]'"


def installed(module: str) -> bool:
    """Return whether a module can be imported."""
    return importlib.util.find_spec(module) is not None


def optional(module: str) -> Any:
    """Return a module of an extra, imported; raise `ImportError`."""
    return importlib.import_module(module)
