# SPDX-License-Identifier: Apache-2.0
"""Results as labelled arrays for papers and notebooks: xarray datasets with units and where their figures are from.

Their tables are `dataset.to_dataframe()`, their plots `dataset.veil.plot()`; `write_csv` keeps units and provenance.
Needs xarray, `pip install 'mr360uw[data]'`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.medium.medium import Medium
from mr360uw.medium.transfer import LightField
from mr360uw.medium.water import Water
from mr360uw.output_gate import check_outputs
from mr360uw.reading.extras import command, optional
from mr360uw.shapes import file_path, instance, numbers
from mr360uw.types import CausticStack

if TYPE_CHECKING:
    from xarray import Dataset

_UNITS = {"wavelength_nm": "nm", "distance_m": "m", "depth_m": "m", "up": "1"}
_CHANNELS = ("red", "green", "blue")


def of_water(water: Water, wavelength_nm: ArrayLike) -> Dataset:
    """Return the optical properties of a water: a, b, c, b_b and K_d.

    Parameters
    ----------
    water : Water
        The water.
    wavelength_nm : array_like
        Wavelengths (n,) [nm].

    Returns
    -------
    xarray.Dataset
        Variables over `wavelength_nm`, in 1/m.

    Raises
    ------
    ParameterError
        If the water is none, a wavelength is beyond its tables, or xarray is not installed.

    Examples
    --------
    >>> made = uw.datasets.of_water(uw.medium.Water.jerlov("IB"), [450.0, 550.0])
    >>> made.K_d.attrs["units"], made.c.shape
    ('1/m', (2,))
    """
    instance("water", water, Water, 'make one, as by Water.jerlov("IB")')
    grid = {"wavelength_nm": wavelength_nm}
    axes = ("wavelength_nm",)
    values = {
        "a": ("absorption", water.absorption(wavelength_nm)),
        "b": ("scattering", water.scattering(wavelength_nm)),
        "c": ("beam attenuation", water.attenuation(wavelength_nm)),
        "b_b": ("backscattering", water.backscattering(wavelength_nm)),
        "K_d": ("diffuse attenuation of downwelling irradiance", water.diffuse_attenuation(wavelength_nm)),
    }
    data = {name: (axes, value, {"long_name": long, "units": "1/m"}) for name, (long, value) in values.items()}
    return _dataset(data, grid, water=water.name, source=water.source)


def of_medium(medium: Medium, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Dataset:
    """Return what a camera sees of the water, on the grid of all arguments.

    Parameters
    ----------
    medium : Medium
        Water and sensor.
    distance_m : array_like
        Distances (n,) [m] to the object.
    depth_m : array_like
        Depths (n,) [m] of the camera.
    up : array_like
        The y components (n,) of the view direction, -1 to 1.

    Returns
    -------
    xarray.Dataset
        The factor `transmittance` on an object's light and the light `veil` that is added, with the axes (distance_m,
        depth_m, up, channel); `irradiance` of a level plane (depth_m, channel). Light is per unit irradiance just below
        the surface, times the medium's gain.

    Raises
    ------
    ParameterError
        If an argument is out of range, or xarray is not installed.

    Examples
    --------
    >>> medium = uw.medium.Medium(uw.medium.Water.jerlov("IB"), mode="kd")
    >>> seen = uw.datasets.of_medium(medium, [1.0, 10.0], [5.0], [0.0])
    >>> dict(seen.veil.sizes)
    {'distance_m': 2, 'depth_m': 1, 'up': 1, 'channel': 3}
    """
    instance("medium", medium, Medium, "make one, as by Medium(water)")
    grid: dict[str, Any] = {"distance_m": distance_m, "depth_m": depth_m, "up": up}
    rays = np.meshgrid(*(np.atleast_1d(numbers(name, one)) for name, one in grid.items()), indexing="ij")
    axes = (*grid, "channel")
    data = {
        "transmittance": (axes, medium.transmittance(*rays), {"long_name": "transmittance of grey", "units": "1"}),
        "veil": (axes, medium.veil(*rays), {"long_name": "veil (path radiance)", "units": "1/sr"}),
        "irradiance": (
            ("depth_m", "channel"), medium.irradiance(rays[1][0, :, 0]),
            {"long_name": "downwelling irradiance", "units": "1"},
        ),
    }  # fmt: skip
    made = _dataset(data, grid, water=medium.water.name, source=medium.water.source, mode=medium.mode)
    return made.assign_coords(channel=list(_CHANNELS)).assign_attrs(sensor=medium.sensor.name, gain=medium.gain)


def of_light_field(field: LightField, depth_m: ArrayLike, up: ArrayLike) -> Dataset:
    """Return the light of a solved field on the grid of its arguments, per unit irradiance at the surface.

    Parameters
    ----------
    field : LightField
        The solved field.
    depth_m : array_like
        Depths (n,) [m].
    up : array_like
        The y components (n,) of directions, -1 to 1.

    Returns
    -------
    xarray.Dataset
        `radiance` (depth_m, up, wavelength) [1/sr] without the sun's own beam; `E_d`, `E_u` and `E_0` (depth_m,
        wavelength) [1], downwelling, upwelling and scalar irradiance with the beam; a and b.

    Raises
    ------
    ParameterError
        If an argument is out of range, or xarray is not installed.

    Examples
    --------
    >>> field = uw.medium.LightField([0.1, 0.3], [0.2, 0.1])
    >>> uw.datasets.of_light_field(field, [1.0, 5.0], [-1.0, 1.0]).E_d.shape
    (2, 2)
    """
    instance("field", field, LightField, "make one, as by LightField([0.1], [0.2])")
    grid = {"depth_m": depth_m, "up": up}
    depth, level = (np.atleast_1d(numbers(name, one)) for name, one in grid.items())
    axes = ("depth_m", "wavelength")
    data = {
        "radiance": (
            ("depth_m", "up", "wavelength"), field.radiance(depth[:, None], level[None, :]),
            {"long_name": "radiance without the sun's beam", "units": "1/sr"},
        ),
        "E_d": (axes, field.irradiance(depth, 1.0), {"long_name": "downwelling irradiance", "units": "1"}),
        "E_u": (axes, field.irradiance(depth, -1.0), {"long_name": "upwelling irradiance", "units": "1"}),
        "E_0": (axes, field.scalar_irradiance(depth), {"long_name": "scalar irradiance", "units": "1"}),
        "a": (("wavelength",), field.absorption, {"long_name": "absorption", "units": "1/m"}),
        "b": (("wavelength",), field.scattering, {"long_name": "scattering", "units": "1/m"}),
    }  # fmt: skip
    return _dataset(data, grid, refractive_index=field.refractive_index)


def of_caustics(stack: CausticStack) -> Dataset:
    """Return the statistics of caustics by depth and channel.

    Parameters
    ----------
    stack : CausticStack
        The maps.

    Returns
    -------
    xarray.Dataset
        Of the irradiance over its mean, with the axes (depth_m, channel) [1]: `mean`, `contrast` (standard deviation
        over mean), `skewness`, and the quantiles `q01`, `q50` and `q99`.

    Raises
    ------
    ParameterError
        If there is no stack, or xarray is not installed.

    Examples
    --------
    >>> sea, settings = uw.caustics.GerstnerSea(wave_count=4), uw.caustics.CausticSettings(size=16, grid=16)
    >>> stack = uw.caustics.caustic_stack(sea, [0.0, 1.0, 0.0], [1.0, 4.0], 0.0, settings)
    >>> uw.datasets.of_caustics(stack).contrast.dims
    ('depth_m', 'channel')
    """
    instance("stack", stack, CausticStack, "make one, as by caustic_stack(sea, sun, depths, time_s)")
    ratio = np.asarray(stack.ratio, np.float64).reshape(len(stack.depth_m), -1, 3)
    mean = ratio.mean(axis=1)
    spread = ratio.std(axis=1)
    third = np.mean((ratio - mean[:, None]) ** 3, axis=1)
    q01, q50, q99 = np.quantile(ratio, (0.01, 0.5, 0.99), axis=1)
    skewness = np.divide(third, spread**3, out=np.zeros_like(third), where=spread > 0.0)
    values = {"mean": mean, "contrast": spread / mean, "skewness": skewness, "q01": q01, "q50": q50, "q99": q99}
    data = {name: (("depth_m", "channel"), value, {"units": "1"}) for name, value in values.items()}
    made = _dataset(data, {"depth_m": stack.depth_m}, tile_m=stack.tile_m, sun_direction=stack.sun_direction)
    return made.assign_coords(channel=list(_CHANNELS))


def write_csv(dataset: Dataset, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a dataset as a CSV table, a row for each point of its grid; units and provenance stand in lines with #.

    Parameters
    ----------
    dataset : xarray.Dataset
        One of this module's, or another with units.
    path : str or Path
        The file; `read_csv` and `pandas.read_csv(path, comment="#")` read it.
    overwrite : bool
        Replace a file that is there.

    Raises
    ------
    OutputExistsError
        If the file is there already and `overwrite` is not set.
    OutputError
        If it may not be written.

    Examples
    --------
    >>> uw.datasets.write_csv(uw.datasets.of_water(uw.medium.Water.pure(), [500.0]), "pure.csv")
    >>> with open("pure.csv", encoding="utf-8") as file:
    ...     [file.readline().strip() for _ in range(2)][1]
    '# water: pure sea water'
    """
    path = file_path("path", path)
    check_outputs([path], overwrite=overwrite)
    facts = [f"# {name}: {_line(value)}" for name, value in dataset.attrs.items()]
    columns = {**dataset.coords, **dataset.data_vars}
    facts += [f"# {name} [{column.attrs.get('units', '')}]" for name, column in columns.items()]
    text = "\n".join([*facts, dataset.to_dataframe().reset_index().to_csv(index=False, float_format="%.17g")])
    write_whole(path, text)


def _dataset(data: dict[str, Any], grid: dict[str, Any], **facts: Any) -> Dataset:
    """Return named arrays on a grid as a dataset that says what made it."""
    from mr360uw import __version__

    try:
        xarray = optional("xarray")
    except ImportError:
        raise ParameterError(f"datasets - need xarray (got none) - {command('data')}") from None
    axes = {name: (name, np.atleast_1d(numbers(name, one)), {"units": _UNITS[name]}) for name, one in grid.items()}
    made: Dataset = xarray.Dataset(data, axes, {"made_by": f"mr360uw {__version__}", **facts})
    return made


def _line(value: Any) -> str:
    return " ".join(str(np.asarray(value).tolist() if isinstance(value, np.ndarray) else value).split())
