# SPDX-License-Identifier: Apache-2.0
"""Packages and their versions; the extras of pyproject.toml, by the word in brackets, are not installed by default."""

from __future__ import annotations

import importlib
import importlib.metadata
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


_PACKAGES = ("numpy", "scipy", "numba", "av", "opencv-contrib-python-headless", "OpenEXR", "moderngl", "trimesh",
             "embreex", "colour-science", "pydantic")  # fmt: skip


def _extra(extra: str) -> str:
    """Return the versions of an extra's packages, or the command that installs it."""
    versions = [(name, _version(name)) for name in EXTRAS[extra]]
    if all(version for _, version in versions):
        return ", ".join(f"{name} {version}" for name, version in versions)
    return f"not installed - {command(extra)}"


def package_versions() -> dict[str, str]:
    """Return the versions of the packages that results depend on, "" for those that are not installed."""
    return {name: _version(name) for name in _PACKAGES}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""
