# SPDX-License-Identifier: Apache-2.0
"""The exceptions of the toolkit, and packages that may be missing.

Every message reads *where - what is wrong (got ...) - what to do*. The library raises them; only the command
line turns them into text and an exit code. Packages of the extras of pyproject.toml are not installed by default.
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any


class Mr360uwError(Exception):
    """Base of everything the toolkit raises on purpose."""


class SceneError(Mr360uwError):
    """A scene file that cannot be run; `problems` holds one line for each thing that is wrong."""

    def __init__(self, where: str, problems: list[str] | tuple[str, ...]) -> None:
        self.where = where
        self.problems = tuple(problems)
        count = f"{len(self.problems)} problem" + ("s" if len(self.problems) != 1 else "")
        super().__init__("\n".join([f"{where}: {count}", *(f"  {line}" for line in self.problems)]))


class VideoError(Mr360uwError):
    """A plate that cannot be read or an output that cannot be written."""


class DamagedFrameError(VideoError):
    """A frame of a plate that cannot be decoded; `index` is its number."""

    def __init__(self, message: str, index: int) -> None:
        super().__init__(message)
        self.index = index

    def __reduce__(self) -> tuple[type[DamagedFrameError], tuple[str, int]]:
        """Return how the error is made again in another process."""
        return DamagedFrameError, (str(self), self.index)


class MeshError(Mr360uwError):
    """A mesh, texture or height map that cannot be used."""


class GlError(Mr360uwError):
    """No OpenGL context, or a shader that does not compile."""


class RenderError(Mr360uwError):
    """A frame whose numbers are not finite; the message names the stage."""


class ParameterError(Mr360uwError, ValueError):
    """An argument outside its physical domain."""


class OutputError(VideoError):
    """An output that may not be written: it would replace an input or another output, or its place is unusable."""


class OutputExistsError(OutputError):
    """The output is already there; nothing is overwritten without being asked to."""


EXTRAS = {
    "data": ("xarray",),
    "farm": ("distributed",),
    "gltf": ("DracoPy", "meshopt"),
    "notebook": ("ipywidgets", "tomlkit"),
    "plot": ("matplotlib",),
    "track": ("pycolmap",),
    "tune": ("nicegui", "tomlkit"),
    "usd": ("usd-core",),
}
"""Packages of each extra that a part of the toolkit needs, by the names with which pip installs them."""


def install_command(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install 'mr360uw[{extra}]'"


def installed(module: str) -> bool:
    """Return whether a module can be imported."""
    return importlib.util.find_spec(module) is not None


def optional(module: str) -> Any:
    """Return a module of an extra, imported; raise `ImportError`."""
    return importlib.import_module(module)


def needed(module: str, extra: str, what: str) -> Any:
    """Return a module of an extra, imported; raise `ParameterError` that names what needs it."""
    try:
        return optional(module)
    except ImportError:
        package = module.partition(".")[0]
        raise ParameterError(f"{what} - needs {package} (got none) - {install_command(extra)}") from None


_PACKAGES = ("numpy", "scipy", "numba", "av", "opencv-contrib-python-headless", "OpenEXR", "moderngl", "trimesh",
             "embreex", "colour-science", "pydantic")  # fmt: skip


def package_versions() -> dict[str, str]:
    """Return the versions of the packages that results depend on, "" for those that are not installed."""
    return {name: _version(name) for name in _PACKAGES}


def extra_versions(extra: str) -> str:
    """Return the versions of an extra's packages, or the command that installs it."""
    versions = [(name, _version(name)) for name in EXTRAS[extra]]
    if all(version for _, version in versions):
        return ", ".join(f"{name} {version}" for name, version in versions)
    return f"not installed - {install_command(extra)}"


def _version(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return ""
