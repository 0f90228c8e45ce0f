# SPDX-License-Identifier: Apache-2.0
"""Plates read through OpenColorIO: by a colour space of a config or a table (.cube), to linear Rec.709 and back.

Both ways are OpenColorIO's own processors, on the CPU, without the approximations that it offers for speed. They
compute in single precision. Cubes are interpolated by tetrahedra, and the inverse is that of the interpolated table.
Values outside of a table's domain are held at its edge.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from mr360uw.base.cache import shared
from mr360uw.base.color import DisplayTransfer, Levels, decode, encode
from mr360uw.base.input_files import DATA, read_text, unreadable
from mr360uw.base.parameters import Parameters, advanced
from mr360uw.errors import ParameterError, VideoError

_BUILT_IN = "ocio://"
_GRID = 17
"""Values of each channel, from 0 to 1, that must come back from light."""
_LARGEST_LOSS = 1e-3
"""Largest difference of a value that came back: a quarter of an 8-bit code. Tables that OCIO inverts keep 1e-4."""
_NAMES_SHOWN = 12  # of a config's colour spaces, in a message


class OcioSettings(Parameters):
    """Colour spaces of an OpenColorIO config, between which the plate's values and its light are converted."""

    input: str = advanced(..., "colour space of the plate's values, by its name in the config")
    working: str = advanced("Linear Rec.709 (sRGB)", "the config's name of linear light with the primaries of Rec.709")
    config: str | Path = advanced(
        "ocio://studio-config-v2.1.0_aces-v1.3_ocio-v2.3",
        "a config that OpenColorIO brings, or a file (.ocio, .ocioz)",
    )

    @field_validator("config", mode="before")
    @classmethod
    def _file(cls, value: object) -> object:
        return Path(value) if isinstance(value, str) and not value.startswith(_BUILT_IN) else value


@dataclass(frozen=True, slots=True)
class OcioMapping:
    """The mapping between a colour space and linear Rec.709; made by `ocio_mapping`; see `color.ColorSpec`.

    config: a built-in one or a file. source, working: its colour spaces. identity: OpenColorIO's own mark of what the
    config holds. on_file_codes: whether values are codes over full scale. is_wide: light may be above white: colour
    spaces do not say.
    """

    config: str
    source: str
    working: str
    identity: str
    on_file_codes: bool
    is_wide: bool = True

    def to_light(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the linear Rec.709 light (..., 3) of values (..., 3)."""
        return self._through(values, self.source, self.working)

    def to_values(self, light: NDArray[Any]) -> NDArray[Any]:
        """Return the values (..., 3) of linear Rec.709 light (..., 3)."""
        return self._through(light, self.working, self.source)

    def _through(self, values: NDArray[Any], source: str, target: str) -> NDArray[Any]:
        return _applied(_processor(self.config, self.identity, source, target), values)


def ocio_mapping(settings: OcioSettings, levels: Levels) -> OcioMapping:
    """Return the mapping of some settings, tried both ways.

    ParameterError where the config has no such colour space; VideoError where it cannot be read.
    """
    name = str(settings.config)
    config = _config(name)
    spaces = list(config.getColorSpaceNames())
    for where, space in (("input", settings.input), ("working", settings.working)):
        if config.getColorSpace(space) is None:
            raise ParameterError(
                f"plate.ocio.{where} - is no colour space of {name} (got {space!r:.60}) - take one of "
                f"{', '.join(spaces[:_NAMES_SHOWN])}{' ...' if len(spaces) > _NAMES_SHOWN else ''}"
            )
    _check_files(config, (settings.input, settings.working), name)
    identity = config.getCacheID()
    for source, target in ((settings.input, settings.working), (settings.working, settings.input)):
        try:
            _processor(name, identity, source, target)
        except _library().Exception as error:
            raise ParameterError(
                f"plate.ocio - {name} does not convert {source} to {target} (got {error!s:.120}) - take a colour space "
                "that can be converted both ways"
            ) from error
    mapping = OcioMapping(name, settings.input, settings.working, identity, levels == "data")
    _check_inverse(mapping)
    return mapping


def _check_inverse(mapping: OcioMapping) -> None:
    """Raise `ParameterError` where values do not come back from light: what is drawn could not be written then."""
    values = unit_grid(_GRID)
    back = np.asarray(mapping.to_values(mapping.to_light(values)), np.float64)
    wrong = float(np.max(np.abs(np.where(np.isfinite(back), back, np.inf) - values)))
    if not wrong <= _LARGEST_LOSS:
        raise ParameterError(
            f"plate.ocio - {mapping.source} does not come back from {mapping.working} (got values that are off by "
            f"{wrong:.3g} of 1) - take a colour space that can be converted both ways without loss"
        )


def unit_grid(count: int) -> NDArray[np.float64]:
    """Return the values (count^3, 3) of three channels at equal steps from 0 to 1, the last one running fastest."""
    steps = np.linspace(0.0, 1.0, count)
    return np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)


def _check_files(config: Any, spaces: Sequence[str], where: str) -> None:
    """Raise `VideoError` where a table that conversions of colour spaces read is missing, no file, or too large."""
    ocio = _library()
    found: list[Path] = []

    def look(transform: Any) -> None:
        if isinstance(transform, ocio.GroupTransform):
            for one in transform:
                look(one)
        elif isinstance(transform, ocio.FileTransform):
            name = Path(config.getCurrentContext().resolveStringVar(transform.getSrc()))
            folders = [Path(config.getWorkingDir()) / part for part in config.getSearchPaths() or ["."]]
            choices = [name] if name.is_absolute() else [folder / name for folder in folders]
            found.append(next((file for file in choices if file.exists()), choices[0]))

    directions = ocio.COLORSPACE_DIR_TO_REFERENCE, ocio.COLORSPACE_DIR_FROM_REFERENCE
    for space in spaces:
        for direction in directions:
            transform = config.getColorSpace(space).getTransform(direction)
            if transform is not None:
                look(transform)
    for file in found:
        if reason := unreadable(file):
            raise VideoError(f"{where} - names a table that cannot be used: {file} - {reason}")
        DATA.check(str(file), file.stat().st_size, VideoError)


@shared(keep=8)
def _processor(config: str, identity: str, source: str, target: str) -> Any:
    """Return OpenColorIO's conversion; identity is what makes the entry of this cache one of the config's content."""
    ocio = _library()
    made = _config(config)
    if made.getCacheID() != identity:
        raise VideoError(f"{config} - changed while it was in use - begin again")
    return made.getProcessor(source, target).getOptimizedCPUProcessor(ocio.OPTIMIZATION_LOSSLESS)


def _config(name: str) -> Any:
    ocio = _library()
    if not name.startswith(_BUILT_IN):
        if reason := unreadable(Path(name)):
            raise VideoError(f"{name} - {reason}")
        DATA.check(name, Path(name).stat().st_size, VideoError)
    try:
        return ocio.Config.CreateFromFile(name)
    except ocio.Exception as error:
        known = [entry[0] for entry in ocio.BuiltinConfigRegistry().getBuiltinConfigs()]
        raise VideoError(
            f"{name} - is no OpenColorIO config that can be read (got {error!s:.120}) - name a file, or one of "
            f"{', '.join(_BUILT_IN + entry for entry in known)}"
        ) from error


def _applied(processor: Any, values: NDArray[Any]) -> NDArray[np.float32]:
    """Return what a processor makes of values (..., 3)."""
    pixels = np.array(values, np.float32, order="C").reshape(-1, 3)
    processor.applyRGB(pixels)
    return pixels.reshape(values.shape)


def _library() -> Any:
    import PyOpenColorIO  # not before a plate asks for it

    return PyOpenColorIO


# --- Tables ---------------------------------------------------------------------------------------------------------

_CELLS = 64
"""Steps of each channel, from 0 to 1, at which a table is turned around: each of a table of 65 or 33 vertices."""
_CLIPPED = 1e-6
"""Distance from the largest and the smallest value of a table, of its range, at which it clips; files have 6 digits."""
_MOST_LOST = 1e-3
"""Most values, of those that are not clipped, that may come back as others of the same light: beside clipped ones a few
do in tables of cameras (7e-5 of them), in one that folds back at a single one of 5 x 5 x 5 vertices 0.026."""


@dataclass(frozen=True)
class CubeMapping:
    """The mapping of a .cube table; made by `cube_mapping`; see `color.PlateMapping`.

    text: of the file. to: encoding of what comes out, Rec.709. on_file_codes: whether values are codes over full scale.
    """

    text: str = field(repr=False)
    to: DisplayTransfer
    on_file_codes: bool
    is_wide: bool = True

    def to_light(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the linear Rec.709 light (..., 3) of values (..., 3)."""
        return np.asarray(decode(_applied(_cube_processor(self.text, inverse=False), values), self.to))

    def to_values(self, light: NDArray[Any]) -> NDArray[Any]:
        """Return the values (..., 3) of linear Rec.709 light (..., 3), the closest of light that no value has."""
        return _applied(_cube_processor(self.text, inverse=True), np.asarray(encode(light, self.to)))

    @property
    def clipped_greys(self) -> str:
        """The ranges of grey from 0 to 1 that the table clips to black or white, in words; "" where it clips none."""
        grey = np.linspace(0.0, 1.0, 1001)  # for a note of three digits
        shown = _applied(_cube_processor(self.text, inverse=False), np.repeat(grey[:, None], 3, axis=1))
        black, white = np.all(shown <= shown[0], axis=1), np.all(shown >= shown[-1], axis=1)
        below, above = grey[black][-1], grey[white][0]
        return " and ".join([f"below {below:.3g}"] * int(below > 0.0) + [f"above {above:.3g}"] * int(above < 1.0))


def cube_mapping(path: Path, to: DisplayTransfer, levels: Levels) -> CubeMapping:
    """Return the mapping of a .cube file, tried both ways; VideoError where it is damaged or cannot be turned around.

    to: encoding of its output. levels: "video": its input is 0 at black and 1 at white; "data": 1 is full scale.
    """
    mapping = CubeMapping(read_text(path, VideoError), to, levels == "data")
    try:
        forward, inverse = (_cube_processor(mapping.text, inverse=turned) for turned in (False, True))
    except _library().Exception as error:
        reason = "; ".join(dict.fromkeys(_reasons(str(error))))
        raise VideoError(f"{path} - is no .cube table that can be read (got {reason}) - export it again") from error
    # Find where values come back as others, though the table does not clip them
    values = unit_grid(_CELLS + 1)
    shown = _applied(forward, values)
    low, high = shown.min(axis=0), shown.max(axis=0)
    if not np.all(np.isfinite(shown)):
        raise VideoError(f"{path} - holds values that are no numbers (got NaN or infinity) - export it again")
    margin = _CLIPPED * (high - low)
    inside = np.all((shown > low + margin) & (shown < high - margin), axis=1)
    lost = inside & (np.max(np.abs(_applied(inverse, shown) - values), axis=1) > _LARGEST_LOSS)
    rises = np.all(shown[-1] > shown[0])
    if np.any(inside) and rises and lost.sum() <= _MOST_LOST * inside.sum():
        return mapping
    wrong = values[lost] if np.any(lost) and rises else values
    ends = zip("RGB", wrong.min(axis=0), wrong.max(axis=0), strict=True)
    region = ", ".join(f"{name} {low:.3g} to {high:.3g}" for name, low, high in ends)
    raise VideoError(
        f"{path} - cannot be turned around: different values become one, or white is not above black (got it at input "
        f"{region}) - light could not be written as the plate's codes; take a table that is technical rather than a "
        "creative look, or name plate.transfer"
    )


def _reasons(told: str) -> list[str]:
    """Return why OpenColorIO's readers of .cube files refuse one."""
    found = re.findall(r"failed with: .*?\(.*?\)\.\s*(.+?)(?=\s*'\w+' failed with|\s*$)", " ".join(told.split()))
    return [reason.rstrip(". ") for reason in found] or [told[:120]]


@shared(keep=8)
def _cube_processor(text: str, *, inverse: bool) -> Any:
    """Return OpenColorIO's processor of a table, from its input to its output or back."""
    ocio = _library()
    with TemporaryDirectory() as folder:  # it reads files, and remembers them by their names
        file = Path(folder, "table.cube")
        file.write_text(text, "utf-8")
        transform = ocio.FileTransform(str(file), interpolation=ocio.INTERP_BEST)
        return _processor_of(transform, inverse=inverse)


def _processor_of(transform: Any, *, inverse: bool) -> Any:
    ocio = _library()
    direction = ocio.TRANSFORM_DIR_INVERSE if inverse else ocio.TRANSFORM_DIR_FORWARD
    made = ocio.Config.CreateRaw().getProcessor(transform, direction)
    return made.getOptimizedCPUProcessor(ocio.OPTIMIZATION_LOSSLESS)


def cube_function(table: NDArray[Any], *, inverse: bool = False) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Return the function of a table (n, n, n, 3) over three channels from 0 to 1, read by tetrahedra, or its inverse.

    It takes and returns values (m, 3). The inverse gives where the table has them, or the closest that it has.
    """
    ocio = _library()
    transform = ocio.Lut3DTransform(len(table))
    transform.setInterpolation(ocio.INTERP_TETRAHEDRAL)
    transform.setData(np.ascontiguousarray(table, np.float32).ravel())
    return functools.partial(_applied, _processor_of(transform, inverse=inverse))
