# SPDX-License-Identifier: Apache-2.0
"""The exceptions of the toolkit.

Every message reads *where - what is wrong (got ...) - what to do*. The library raises them; only the command
line turns them into text and an exit code.
"""

from __future__ import annotations


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
