# SPDX-License-Identifier: Apache-2.0
"""Plates read through OpenColorIO: from a colour space of a config to the toolkit's linear Rec.709, and back.

Both ways are OpenColorIO's own processors, on the CPU, without the approximations that it offers for speed.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from mr360uw.base.color import Levels
from mr360uw.base.input_files import DATA, unreadable
from mr360uw.base.parameters import Parameters, advanced
from mr360uw.errors import ParameterError, VideoError, install_command

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
        pixels = np.array(values, np.float32, order="C").reshape(-1, 3)
        _processor(self.config, self.identity, source, target).applyRGB(pixels)
        return pixels.reshape(values.shape)


def ocio_mapping(settings: OcioSettings, levels: Levels) -> OcioMapping:
    """Return the mapping of some settings, tried both ways.

    ParameterError where OpenColorIO is not installed or the config has no such colour space; VideoError where the
    config cannot be read.
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
    steps = np.linspace(0.0, 1.0, _GRID)
    values = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    back = np.asarray(mapping.to_values(mapping.to_light(values)), np.float64)
    wrong = float(np.max(np.abs(np.where(np.isfinite(back), back, np.inf) - values)))
    if not wrong <= _LARGEST_LOSS:
        raise ParameterError(
            f"plate.ocio - {mapping.source} does not come back from {mapping.working} (got values that are off by "
            f"{wrong:.3g} of 1) - take a colour space that can be converted both ways without loss"
        )


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


@functools.lru_cache(maxsize=8)
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


def _library() -> Any:
    try:
        import PyOpenColorIO
    except ImportError as error:
        raise ParameterError(
            f"plate.ocio - needs OpenColorIO, which is not installed - {install_command('ocio')}"
        ) from error
    return PyOpenColorIO
