# SPDX-License-Identifier: Apache-2.0
"""Results as labelled arrays for papers and notebooks: xarray datasets with units and where their figures are from.

Their tables are `dataset.to_dataframe()`, their plots `dataset.veil.plot()`; `write_csv` keeps units and provenance.
Needs xarray, `pip install 'mr360uw[data]'`.
"""

from __future__ import annotations

import csv
import itertools
import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import NonNegativeInt, PositiveInt

from mr360uw.base.cache import drop_shared
from mr360uw.base.files import check_outputs, write_whole
from mr360uw.base.input_files import read_text
from mr360uw.base.parameters import Parameters, checked, file_path, instance, numbers
from mr360uw.errors import ParameterError, needed
from mr360uw.medium.layers import LayeredField
from mr360uw.medium.medium import Medium
from mr360uw.medium.transfer import LightField
from mr360uw.medium.water import Water
from mr360uw.medium.waterfit import resampled
from mr360uw.scene.model import Scene
from mr360uw.types import CausticStack

if TYPE_CHECKING:
    from xarray import Dataset

    from mr360uw.runs.compositor import FrameResult

_UNITS = {"wavelength_nm": "nm", "distance_m": "m", "depth_m": "m", "top_m": "m", "up": "1"}
_CHANNELS = ("red", "green", "blue")


def of_water(water: Water, wavelength_nm: ArrayLike) -> Dataset:
    """Return the optical properties of a water: a, b, c, b_b and K_d.

    For tables and plots of a paper: the arrays know their units, the dataset the name of the water and the source of
    its figures.

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

    See Also
    --------
    uw.medium.Water : The same as plain arrays.
    uw.datasets.of_medium : What a camera sees of the water.
    uw.datasets.write_csv : Writes it as a table.

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
    data = {name: _quantity(axes, value, long, "1/m") for name, (long, value) in values.items()}
    return _dataset(data, grid, water=water.name, source=water.source)


@checked
def of_medium(medium: Medium, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Dataset:
    """Return what a camera sees of the water, on the grid of all arguments.

    Every distance meets every depth and direction. The dataset names water, source, mode, sensor and gain.

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

    See Also
    --------
    uw.medium.Medium : The same as plain arrays.
    uw.datasets.of_light_field : Light by wavelength, without a sensor.
    uw.datasets.write_csv : Writes it as a table.

    Examples
    --------
    >>> medium = uw.medium.Medium(uw.medium.Water.jerlov("IB"), mode="kd")
    >>> seen = uw.datasets.of_medium(medium, [1.0, 10.0], [5.0], [0.0])
    >>> dict(seen.veil.sizes)
    {'distance_m': 2, 'depth_m': 1, 'up': 1, 'channel': 3}
    """
    grid: dict[str, Any] = {"distance_m": distance_m, "depth_m": depth_m, "up": up}
    rays = np.meshgrid(*(_axis(name, one) for name, one in grid.items()), indexing="ij")
    axes = (*grid, "channel")
    data = {
        "transmittance": _quantity(axes, medium.transmittance(*rays), "transmittance of grey"),
        "veil": _quantity(axes, medium.veil(*rays), "veil (path radiance)", "1/sr"),
        "irradiance": _quantity(("depth_m", "channel"), medium.irradiance(rays[1][0, :, 0]), "downwelling irradiance"),
    }
    made = _dataset(data, grid, water=medium.water.name, source=medium.water.source, mode=medium.mode)
    return made.assign_coords(channel=list(_CHANNELS)).assign_attrs(sensor=medium.sensor.name, gain=medium.gain)


@checked
def of_light_field(
    field: LightField | LayeredField, depth_m: ArrayLike, up: ArrayLike, wavelength_nm: ArrayLike | None = None
) -> Dataset:
    """Return the light of a solved field on the grid of its arguments, per unit irradiance at the surface.

    Every depth meets every direction. A field has coefficients alone: where no wavelengths are given, the axis
    `wavelength` is their order.

    Parameters
    ----------
    field : LightField or LayeredField
        The solved field.
    depth_m : array_like
        Depths (n,) [m].
    up : array_like
        The y components (n,) of directions, -1 to 1.
    wavelength_nm : array_like, optional
        Wavelengths (n,) [nm] of the field's coefficients, which become the axis `wavelength_nm`.

    Returns
    -------
    xarray.Dataset
        `radiance` (depth_m, up, wavelength) [1/sr] without the sun's own beam; `E_d`, `E_u` and `E_0` (depth_m,
        wavelength) [1], downwelling, upwelling and scalar irradiance with the beam; a and b, of layers by the depth
        `top_m` at which they begin.

    Raises
    ------
    ParameterError
        If an argument is out of range, there are more or fewer wavelengths than coefficients, or xarray is not
        installed.

    See Also
    --------
    uw.medium.LightField : The same as plain arrays.
    uw.datasets.of_water : The coefficients of a water.
    uw.datasets.write_csv : Writes it as a table.

    Examples
    --------
    >>> field = uw.medium.LightField([0.1, 0.3], [0.2, 0.1])
    >>> uw.datasets.of_light_field(field, [1.0, 5.0], [-1.0, 1.0]).E_d.shape
    (2, 2)
    """
    grid = {"depth_m": depth_m, "up": up}
    depth, level = (_axis(name, one) for name, one in grid.items())
    # Name the axes of coefficients: wavelengths, and layers before them
    spectrum, count, facts = "wavelength", field.absorption.shape[-1], {}
    own: tuple[str, ...]
    if wavelength_nm is not None:
        spectrum, given = "wavelength_nm", _axis("wavelength_nm", wavelength_nm)
        if len(given) != count:
            raise ParameterError(
                f"wavelength_nm - needs one for each coefficient (got {len(given)} for {count}) - give as many"
            )
        grid["wavelength_nm"] = given
    if isinstance(field, LayeredField):
        grid["top_m"], own = field.top_m, ("top_m", spectrum)
    else:
        own, facts = (spectrum,), {"refractive_index": field.refractive_index}
    axes, rays = ("depth_m", spectrum), ("depth_m", "up", spectrum)
    data = {
        "radiance": _quantity(
            rays, field.radiance(depth[:, None], level[None, :]), "radiance without the sun's beam", "1/sr"
        ),
        "E_d": _quantity(axes, field.irradiance(depth, 1.0), "downwelling irradiance"),
        "E_u": _quantity(axes, field.irradiance(depth, -1.0), "upwelling irradiance"),
        "E_0": _quantity(axes, field.scalar_irradiance(depth), "scalar irradiance"),
        "a": _quantity(own, field.absorption, "absorption", "1/m"),
        "b": _quantity(own, field.scattering, "scattering", "1/m"),
    }
    return _dataset(data, grid, **facts)


def of_caustics(stack: CausticStack, *made_with: Parameters, time_s: float | None = None) -> Dataset:
    """Return the statistics of caustics by depth and channel.

    The maps are of one instant: for the statistics of a sea, average over stacks at several times.

    Parameters
    ----------
    stack : CausticStack
        The maps.
    *made_with : GerstnerSea, SpectralSea or CausticSettings
        What they were made with, whose values the dataset then knows: wind, seed, size of the map and so on.
    time_s : float, optional
        Their time [s], to be known likewise.

    Returns
    -------
    xarray.Dataset
        Of the irradiance over its mean, with the axes (depth_m, channel) [1]: `mean`, `contrast` (standard deviation
        over mean), `skewness`, and the quantiles `q01`, `q50` and `q99`.

    Raises
    ------
    ParameterError
        If there is no stack, or xarray is not installed.

    See Also
    --------
    uw.caustics.caustic_stack : Makes the maps.
    uw.datasets.write_csv : Writes it as a table.

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
    facts: dict[str, Any] = {} if time_s is None else {"time_s": time_s}
    for one in made_with:
        held = instance("made_with", one, Parameters, "give the sea or the settings that the maps were made with")
        facts |= {name: value for name, value in held if isinstance(value, int | float | str)}
    made = _dataset(data, {"depth_m": stack.depth_m}).assign_attrs(facts)
    made = made.assign_attrs(tile_m=stack.tile_m, sun_direction=stack.sun_direction)
    return made.assign_coords(channel=list(_CHANNELS))


@checked
def write_csv(dataset: Dataset, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a dataset as a CSV table, a row for each point of its grid; units and provenance stand in lines with #.

    Numbers have 17 digits, so that they are the same bits when they are read.

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

    See Also
    --------
    uw.datasets.read_csv : Reads it.
    uw.datasets.of_medium : Makes a dataset.

    Examples
    --------
    >>> uw.datasets.write_csv(uw.datasets.of_water(uw.medium.Water.pure(), [500.0]), "pure.csv")
    >>> with open("pure.csv", encoding="utf-8") as file:
    ...     [file.readline().strip() for _ in range(2)][1]
    '# water: pure sea water'
    """
    path, dataset = file_path("path", path), instance("dataset", dataset, _xarray().Dataset, "of_water makes one")
    check_outputs([path], overwrite=overwrite)
    missing = {name: np.arange(size) for name, size in dataset.sizes.items() if name not in dataset.coords}
    dataset = dataset.assign_coords(missing)
    facts = [f"# {name}: {_line(value)}" for name, value in dataset.attrs.items()]
    columns = {**dataset.coords, **dataset.data_vars}
    facts += [
        f"# {name} [{column.attrs.get('units', '')}] over {', '.join(map(str, column.dims))}: "
        f"{column.attrs.get('long_name', name)}"
        for name, column in columns.items()
    ]
    text = "\n".join([*facts, dataset.to_dataframe().reset_index().to_csv(index=False, float_format="%.17g")])
    write_whole(path, text)


def read_csv(path: str | Path) -> Dataset:
    """Return a dataset that `write_csv` wrote: axes, variables, units and provenance as they were.

    Tables of other programs lack the lines on axes and units: read them with pandas.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    xarray.Dataset
        With attributes as text.

    Raises
    ------
    ParameterError
        If the file cannot be read or was not written by `write_csv`, or xarray is not installed.

    See Also
    --------
    uw.datasets.write_csv : Writes one.

    Examples
    --------
    >>> made = uw.datasets.of_water(uw.medium.Water.pure(), [500.0, 600.0])
    >>> uw.datasets.write_csv(made, "water_of_paper.csv")
    >>> uw.datasets.read_csv("water_of_paper.csv").K_d.equals(made.K_d)
    True
    """
    xarray = _xarray()
    lines = read_text(file_path("path", path), ParameterError).splitlines()
    columns = dict(filter(None, map(_column, lines)))
    facts = dict(line[2:].split(": ", 1) for line in lines if line.startswith("# ") and _column(line) is None)
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    if not columns or not rows or set(rows[0]) != set(columns):
        raise ParameterError(f"{path} - is no table of `write_csv` (got {len(rows)} rows) - write it with write_csv")
    values = {name: np.array([_value(row[name]) for row in rows]) for name in columns}
    axes = {name: list(dict.fromkeys(values[name].tolist())) for name, (dims, _) in columns.items() if dims == (name,)}
    places = {name: [axis.index(value) for value in values[name].tolist()] for name, axis in axes.items()}
    data = {}
    for name, (dims, attributes) in columns.items():
        if name in axes:
            continue
        array = np.empty([len(axes[dim]) for dim in dims], values[name].dtype)
        array[tuple(places[dim] for dim in dims)] = values[name]
        data[name] = (dims, array, attributes)
    given = {name: (name, np.array(axis), columns[name][1]) for name, axis in axes.items()}
    made: Dataset = xarray.Dataset(data, given, facts)
    return made


@checked
def spread(
    fit: Callable[[list[Any]], ArrayLike], frames: Sequence[Any], draws: PositiveInt = 200, seed: NonNegativeInt = 1
) -> Dataset:
    """Return how far a fit changes with the frames that it is made of, by resampling them.

    It is the bootstrap of independent frames: frames of a clip that are seconds apart, not neighbours, are nearly that.
    The fit is made once more than `draws`.

    Parameters
    ----------
    fit : callable
        Makes a number, or an array of one shape, from a list of frames: a gain, a Kd, the wind.
    frames : sequence
        What the fit takes, one for each frame: radiance maps, patterns of caustics.
    draws : int
        Times that as many frames are drawn with replacement, 2 or more.
    seed : int
        Seed of the draws.

    Returns
    -------
    xarray.Dataset
        `fit` of all frames; `mean`, `std`, `q05` and `q95` over the draws.

    Raises
    ------
    ParameterError
        If there are no frames, or fewer than two draws, or xarray is not installed.

    See Also
    --------
    uw.medium.fit_gain : A fit of the veil's gain.
    uw.medium.fit_water : A fit of the water's type, with Kd.

    Examples
    --------
    >>> found = uw.datasets.spread(lambda frames: np.mean(frames), [1.0, 2.0, 3.0, 4.0], draws=400)
    >>> float(found.fit), round(float(found["std"]), 1)
    (2.5, 0.6)
    """
    found = np.array([np.asarray(value, np.float64) for value in resampled(fit, frames, draws, seed)])
    axes = tuple(f"axis_{k}" for k in range(found.ndim - 1))
    values = {
        "fit": np.asarray(fit(list(frames)), np.float64),
        "mean": found.mean(axis=0),
        "std": found.std(axis=0, ddof=1),
    }
    values |= dict(zip(("q05", "q95"), np.quantile(found, (0.05, 0.95), axis=0), strict=True))
    data = {name: (axes, value) for name, value in values.items()}
    return _dataset(data, {}, frames=len(frames), draws=draws, seed=seed)


Measure = Callable[["FrameResult"], "ArrayLike | Mapping[str, ArrayLike]"]
"""What a study keeps of a frame: a number or an array of one shape, or some by name."""


@checked
def sweep(
    scene: Scene,
    values: Mapping[str, Sequence[Any]],
    measure: Measure | None = None,
    *,
    frame: NonNegativeInt = 0,
    backend: str = "auto",
    client: Any = None,
) -> Dataset:
    """Return a frame of a scene, or measures of it, for every combination of values of some keys.

    For studies: which water, depth or wind gives what. All combinations are checked before the first is drawn. Frames
    are drawn one after the other and dropped once they are measured; what they share is made once.

    Parameters
    ----------
    scene : Scene
        The scene. Its light is measured in the one frame, as `mr360uw still` does.
    values : dict
        Values of each key, named as in `--set`: {"water.type": ["IB", "II"], "camera.depth_m": [5.0, 10.0]}.
    measure : callable, optional
        Makes a number, an array, or a dictionary of such from a `FrameResult`; without it the pictures are kept, which
        takes 12 bytes a pixel.
    frame : int
        Number of the plate's frame, from 0.
    backend : {"auto", "gl", "reference"}
        The renderer.
    client : dask.distributed.Client, optional
        Spreads the combinations over its workers, which must see the same files.

    Returns
    -------
    xarray.Dataset
        Variables over the keys, then over axes of their own: `picture` (..., row, column, channel), linear, without a
        measure; `measure` or the names that it gives with one.

    Raises
    ------
    SceneError
        With one line for each problem of the first combination that has any.
    ParameterError
        If there are no values, or xarray is not installed.

    See Also
    --------
    uw.render_frame : One frame of a plate of one's own.
    uw.Scene.with_ : One variant of a scene.

    Examples
    --------
    >>> depths = {"camera.depth_m": [3.0, 12.0]}
    >>> study = uw.sweep(scene, depths, lambda result: result.image_linear.mean(axis=(0, 1)), backend="reference")
    >>> study.measure.dims
    ('camera.depth_m', 'measure_0')
    """
    listed = {
        name: isinstance(some, Sequence | np.ndarray) and not isinstance(some, str) for name, some in values.items()
    }
    axes = {
        name: [one.item() if isinstance(one, np.generic) else one for one in some] if listed[name] else []
        for name, some in values.items()
    }
    if not axes or not all(axes.values()):
        raise ParameterError(
            f'values - needs a list for each key (got {values!r:.80}) - give one, as {{"water.type": ["IB", "II"]}}'
        )
    if not (client is None or hasattr(client, "gather")):
        raise ParameterError(f"client - is none of Dask (got {client!r:.40}) - make a dask.distributed.Client")
    # Make and check all variants, then draw and measure them
    combinations = list(itertools.product(*axes.values()))
    variants = [
        scene.with_(*(f"{name}={json.dumps(one)}" for name, one in zip(axes, combination, strict=True)))
        for combination in combinations
    ]
    xarray, take = _xarray(), partial(_measured, measure=measure, frame=frame, backend=backend)
    if client is None:
        found = take(variants)
    else:
        batches = [variants[k :: max(len(client.ncores()), 1)] for k in range(max(len(client.ncores()), 1))]
        parts = client.gather(client.map(take, [batch for batch in batches if batch], pure=False))
        found = [parts[k % len(parts)][k // len(parts)] for k in range(len(variants))]
    # Lay them out over the keys
    size, data = tuple(map(len, axes.values())), {}
    for name in found[0]:
        array = np.array([one[name] for one in found])
        own = ("row", "column", "channel") if measure is None else tuple(f"{name}_{k}" for k in range(array.ndim - 1))
        data[name] = ((*axes, *own), array.reshape(*size, *array.shape[1:]))
    from mr360uw import __version__

    made: Dataset = xarray.Dataset(data, axes, {"made_by": f"mr360uw {__version__}", "frame": frame})
    return made.assign_coords(channel=list(_CHANNELS)) if measure is None else made


_TOGETHER = 16
"""Frames of a study after which the waters that were solved for them are let go of: they take some 60 MB each."""


def _measured(variants: list[Scene], measure: Measure | None, frame: int, backend: str) -> list[dict[str, Any]]:
    """Return what is kept of a frame of each of some scenes, by name."""
    from mr360uw.preview.live import LivePreview
    from mr360uw.runs.compositor import result_of

    found = []
    with LivePreview(backend) as live:
        for number, variant in enumerate(variants):
            if number % _TOGETHER == _TOGETHER - 1:
                drop_shared()
            result = result_of(live.frame(variant, frame))
            kept = {"picture": result.image_linear} if measure is None else measure(result)
            found.append(dict(kept) if isinstance(kept, Mapping) else {"measure": kept})
    return found


_COLUMN = re.compile(r"# (\w+) \[(.*?)\] over (.*?): (.*)$")


def _axis(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return values (n,) along an axis of a grid, of a number or some; raise `ParameterError` for other shapes."""
    array = np.atleast_1d(numbers(name, values))
    if array.ndim > 1 or not len(array):
        raise ParameterError(f"{name} - must be a number or a list of them (got shape {array.shape}) - give one axis")
    return array


def _column(line: str) -> tuple[str, tuple[tuple[str, ...], dict[str, str]]] | None:
    """Return the name of a column, its axes and its attributes from the line that says so."""
    found = _COLUMN.match(line)
    if found is None:
        return None
    attributes = {"long_name": found[4]} if found[4] != found[1] else {}
    return found[1], (tuple(filter(None, found[3].split(", "))), attributes | ({"units": found[2]} if found[2] else {}))


def _value(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


def _quantity(axes: tuple[str, ...], values: ArrayLike, name: str, unit: str = "1") -> tuple[Any, ...]:
    """Return a variable of a dataset over some axes."""
    return axes, values, {"long_name": name, "units": unit}


def _xarray() -> Any:
    return needed("xarray", "data", "datasets")


def _dataset(data: dict[str, Any], grid: dict[str, Any], **facts: Any) -> Dataset:
    """Return named arrays on a grid as a dataset that says what made it."""
    from mr360uw import __version__

    xarray = _xarray()
    axes = {name: (name, np.atleast_1d(numbers(name, one)), {"units": _UNITS[name]}) for name, one in grid.items()}
    made: Dataset = xarray.Dataset(data, axes, {"made_by": f"mr360uw {__version__}", **facts})
    return made


def _line(value: Any) -> str:
    return " ".join(str(np.asarray(value).tolist() if isinstance(value, np.ndarray) else value).split())
