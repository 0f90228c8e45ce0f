# SPDX-License-Identifier: Apache-2.0
"""Arguments and options that several commands share, their text as values, the gate before every command, and what
commands say.

Every file that the command line names is declared as read or written, and what is written passes the gate first.
"""

from __future__ import annotations

import functools
import inspect
import itertools
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_type_hints

import typer

from mr360uw.base.files import check_folder, check_outputs
from mr360uw.base.input_files import unreadable
from mr360uw.errors import ParameterError

if TYPE_CHECKING:
    from mr360uw.types import View


class Role(Enum):
    """Role of a file that an argument or an option names: read, written or a folder. It stands in its annotation."""

    READ = "read"
    WRITTEN = "written"
    FOLDER = "filled"


def gated(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that raises `OutputError` before it does anything where an output may not be written.

    Before that `ParameterError` names every input that is a device, a pipe or a socket: to open one may wait for ever.

    Commands whose outputs have other names than the given ones, or whose scene names more inputs, check these too.
    Options that belong together are a parameter whose type is a dataclass of them.
    """

    @functools.wraps(command)
    def checked(**values: Any) -> None:
        named = dict(roles_of(command))
        paths = {role: [Path(values[name]) for name in named if named[name] is role and values[name]] for role in Role}
        writes = not values.get("explain", False)
        _check_read(paths[Role.READ])
        for folder in paths[Role.FOLDER]:
            check_folder(folder)
        check_outputs(
            paths[Role.WRITTEN], inputs=paths[Role.READ], overwrite=values.get("overwrite", False) or not writes
        )
        groups: dict[str, Any] = {name: kind for name, kind in get_type_hints(command).items() if is_dataclass(kind)}
        for name, kind in groups.items():
            values[name] = kind(**{one.name: values.pop(one.name) for one in fields(kind)})
        command(**values)

    checked.__signature__, checked.__annotations__ = inspect.Signature(list(options_of(command))), {}  # type: ignore[attr-defined]
    return checked


def options_of(command: Callable[..., Any]) -> Iterator[inspect.Parameter]:
    """Yield the arguments and options of a command, those of a dataclass one by one."""
    hints = get_type_hints(command, include_extras=True)
    for name, one in inspect.signature(command).parameters.items():
        if is_dataclass(hints[name]):
            yield from options_of(hints[name])
        else:
            yield one.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY)


def _check_read(paths: Sequence[Path]) -> None:
    """Raise `ParameterError` with a line for each path that is there, and neither a file nor a folder."""
    special = [path for path in paths if path.exists() and not path.is_file() and not path.is_dir()]
    if special:
        raise ParameterError("\n".join(f"{path} - {unreadable(path)}" for path in special))


def roles_of(command: Callable[..., None]) -> Iterator[tuple[str, Role]]:
    """Yield the parameters of a command that name files, with what is done with these."""
    for one in options_of(command):
        yield from ((one.name, role) for role in get_args(one.annotation)[1:] if isinstance(role, Role))


SceneArgument = Annotated[Path, typer.Argument(help="scene file (TOML)", show_default=False), Role.READ]
FramesOption = Annotated[
    str | None,
    typer.Option(help="frames a:b, b not included, as a sequence's files are numbered; either may be left out"),
]
BackendOption = Annotated[str, typer.Option(help="auto, gl or reference")]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="replace an output that is there")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="override one key of the scene, as in --set camera.depth_m=8")
]
ScaleOption = Annotated[float | None, typer.Option(help="size over the plate's, for drafts, as in 0.25")]
ProgressOption = Annotated[bool, typer.Option("--progress-lines", help="a line for each frame, no bar")]
FrameOption = Annotated[int | None, typer.Option(help="number of the frame; default: the first")]
TimeOption = Annotated[float | None, typer.Option("--time", help="seconds from the start, instead")]
ViewOption = Annotated[str | None, typer.Option(help="yaw,pitch,fov in degrees; default: the whole panorama")]
SizeOption = Annotated[str, typer.Option(help="of a view, in pixels")]


EyeOption = Annotated[Literal["left", "right"] | None, typer.Option(help="eye of a stereo plate to work on")]
JsonOption = Annotated[bool, typer.Option("--json", help="print what is found as one line of JSON, for programs")]


def frame_range(text: str | None) -> tuple[int, int | None]:
    """Return (start, stop) of 'a:b'; a single number k means k:k+1."""
    if text is None:
        return 0, None
    head, colon, tail = text.partition(":")
    try:
        start = int(head) if head or not colon else 0
        stop = (int(tail) if tail else None) if colon else start + 1
    except ValueError:
        raise ParameterError(f"--frames - is not a range (got {text!r}) - write a:b, as in 0:48") from None
    if start < 0 or (stop is not None and stop <= start):
        raise ParameterError(f"--frames - is empty or negative (got {text!r}) - write a:b with 0 <= a < b")
    return start, stop


def worker_count(text: str) -> int | Literal["auto"]:
    """Return the number of processes of `--workers`."""
    if text == "auto":
        return "auto"
    if not text.isdecimal() or int(text) < 1:
        raise ParameterError(f"--workers - is no number of processes (got {text!r}) - give 1 or more, or auto")
    return int(text)


def view_of(text: str | None, size: str) -> View | None:
    """Return the view of 'yaw,pitch,fov' in degrees, whose end may be left out, and of a size '1280x720'."""
    if text is None:
        return None
    from mr360uw.preview.screen import perspective

    try:
        angles = [float(part) for part in text.split(",")]
        width, height = (int(part) for part in size.lower().split("x"))
    except ValueError:
        raise ParameterError(
            f"--view, --size - are no view (got {text!r}, {size!r}) - write yaw,pitch,fov in degrees, as in 30,-10,75, "
            "and 1280x720"
        ) from None
    if len(angles) > 3:
        raise ParameterError(f"--view - has too many numbers (got {text!r}) - write yaw,pitch,fov, as in 30,-10,75")
    return perspective(
        **dict(zip(("yaw_deg", "pitch_deg", "fov_deg"), angles, strict=False)), width=width, height=height
    )


def variants(overrides: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the combinations of 'key=a,b,c' overrides; the last key varies fastest, commas within [ ] do not split."""
    choices = []
    for text in overrides:
        key, equals, values = text.partition("=")
        if not equals or not values.strip():
            raise ParameterError(
                f"--set - is no override (got {text!r}) - write key=value,value, as in water.type=IB,II"
            )
        choices.append([f"{key}={value.strip()}" for value in re.split(r",(?![^\[]*\])", values)])
    return list(itertools.product(*choices))


class Said:
    """What a command says: its lines as they come or, as JSON, all of them at the end, with what was found."""

    def __init__(self, as_json: bool) -> None:
        self._json, self._lines = as_json, list[str]()

    def __call__(self, text: str) -> None:
        """Say some lines."""
        if self._json:
            self._lines += text.splitlines()
        else:
            typer.echo(text)

    def end(self, **found: object) -> None:
        """Print the JSON object, if asked for: what was found by its names, and `said`, the lines."""
        if self._json:
            typer.echo(json.dumps({name: _plain(value) for name, value in found.items()} | {"said": self._lines}))


_MOST_NUMBERS = 64
"""Numbers of an array that stand in JSON: vectors and small tables; longer ones are in the files that are written."""


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: a record without its long arrays, and null for what is not finite or unknown."""
    if is_dataclass(value):
        inside = {one.name: getattr(value, one.name) for one in fields(value)}
        return {name: _plain(one) for name, one in inside.items() if getattr(one, "size", 0) <= _MOST_NUMBERS}
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
