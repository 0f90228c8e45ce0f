# SPDX-License-Identifier: Apache-2.0
"""Caustic, height and normal maps as tileable image sequences for other programs, which loop without a seam."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.files import check_outputs, made_folder, whole_file, write_whole
from mr360uw.base.input_files import FRAMES
from mr360uw.base.parameters import checked
from mr360uw.caustics.irradiance import caustic_map, check_arguments, pass_indices
from mr360uw.caustics.settings import CausticSettings, Sea, grid_of
from mr360uw.errors import ParameterError, VideoError
from mr360uw.types import Floats

PAGE = "tiles.json"
"""File of a folder of maps that says what they are."""
ImageFormat = Literal["png", "exr"]

CAUSTIC_WHITE = 8.0
"""Irradiance ratio of white in PNG; brighter caustics clip there, but not in EXR. Twice as large, dark codes halve."""
_INVERSIONS = 12
"""Fixed-point steps that undo the horizontal shift; each gains a factor of the surface's steepness, below 1."""
_SURFACE_OVERSAMPLING = 2
"""Surface points across a pixel of the map: the spline then resolves the shortest waves of the map."""


@checked
def export_tiles(
    sea: Sea,
    sun_direction_in_air: ArrayLike,
    depth_m: float,
    folder: str | Path,
    frames: int = 48,
    loop_s: float = 8.0,
    settings: CausticSettings | None = None,
    image_format: ImageFormat = "png",
    *,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Path, ...]:
    """Write caustics, heights and normals as picture sequences that repeat in space and time; return their paths.

    Names are caustic_0000.png, height_0000.png, normal_0000.png; column = +x, row = +z, all on the regular world grid
    (pixel centres). PNG has 16 bits, linear: caustic white = 8, height 0.5 + h/(2 height_range_m), normal (x, z, y)/2 +
    0.5. EXR holds the ratio, metres, and (x, z, y) as they are. tiles.json holds these scales, the tile's size and the
    loop. Every file is whole or absent.

    Parameters
    ----------
    sea : GerstnerSea or SpectralSea
        The surface, whose frequencies move to multiples of 1/loop_s.
    sun_direction_in_air : array_like
        Direction (3,) towards the sun, above the horizon.
    depth_m : float
        Depth [m] of the plane below the mean surface, 0 to 11000.
    folder : str or Path
        Folder of the files, which is made.
    frames : int
        Pictures of a loop, 1 or more.
    loop_s : float
        Length [s] of the loop, above 0 and up to 3600.
    settings : CausticSettings, optional
        Size of the maps, method and the sun's disc.
    image_format : {"png", "exr"}
        Format of the pictures.
    refractive_index : float
        Index of the water at 550 nm relative to air.
    overwrite : bool
        Replace files that are there.
    progress : callable, optional
        Is called with (done, frames).

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    OutputExistsError
        If files are there already and `overwrite` is not set.
    ParameterError
        If an argument is outside its domain.

    See Also
    --------
    uw.caustics.caustic_map : One map in memory.
    uw.caustics.GerstnerSea.surface : Heights and normals in memory.

    Examples
    --------
    >>> sea, settings = uw.caustics.GerstnerSea(wave_count=4), uw.caustics.CausticSettings(size=16, grid=16)
    >>> paths = uw.caustics.export_tiles(sea, [0.0, 1.0, 0.0], 3.0, "tiles", frames=1, settings=settings)
    >>> [path.name for path in paths]
    ['caustic_0000.png', 'height_0000.png', 'normal_0000.png', 'tiles.json']
    """
    s = settings or CausticSettings()
    sun = check_arguments(sun_direction_in_air, [depth_m], s.size, refractive_index, s.sun_half_angle_rad)
    grid = grid_of(s, sea, depth_m)
    paths = _free_paths(Path(folder), frames, loop_s, image_format, overwrite=overwrite)
    looping = type(sea).model_validate(sea.model_dump() | {"loop_s": loop_s})
    write = _write_png if image_format == "png" else _write_exr
    height_range = _height_range(looping, loop_s)
    with made_folder(Path(folder)):
        for i in range(frames):
            time_s = loop_s * i / frames
            height, normal = world_grid(looping, s.size, time_s)
            maps = [
                caustic_map(looping, sun, depth_m, time_s, s.size, grid, index, s.sun_half_angle_rad, s.method)
                for index in pass_indices(s.chromatic, refractive_index)
            ]
            caustic = np.broadcast_to(np.stack(maps, axis=-1), (s.size, s.size, 3))
            images = {"caustic": caustic, "height": height[..., None], "normal": normal[..., [0, 2, 1]]}
            for name, image in (_codes(images, height_range) if image_format == "png" else images).items():
                with whole_file(paths[name][i]) as part:
                    write(image, part)
            if progress is not None:
                progress(i + 1, frames)
        about = {
            "tile_m": sea.tile_m, "loop_s": loop_s, "frames": frames, "depth_m": depth_m, "size": s.size,
            "sun_direction_in_air": sun.tolist(), "refractive_index": refractive_index,
            "caustic_white": CAUSTIC_WHITE if image_format == "png" else None,
            "height_range_m": height_range if image_format == "png" else None, "sea": looping.model_dump(mode="json"),
        }  # fmt: skip
        page = Path(folder) / PAGE
        write_whole(page, json.dumps(about, indent=2) + "\n")
    return (*(p for group in paths.values() for p in group), page)


def _free_paths(
    folder: Path, frames: int, loop_s: float, image_format: ImageFormat, *, overwrite: bool
) -> dict[str, list[Path]]:
    """Return the images' paths by name; raise what `export_tiles` says."""
    if frames < 1 or not 0.0 < loop_s <= 3600.0:
        raise ParameterError(
            f"frames, loop_s - need a frame and a time in (0, 3600] (got {frames}, {loop_s}) - correct them"
        )
    FRAMES.check("frames", frames, ParameterError)
    names = ("caustic", "height", "normal")
    paths = {n: [folder / f"{n}_{i:04d}.{image_format}" for i in range(frames)] for n in names}
    outputs = [*(path for group in paths.values() for path in group), folder / PAGE]
    check_outputs(outputs, overwrite=overwrite, folder=folder)
    return paths


def _codes(images: dict[str, Floats], height_range_m: float) -> dict[str, Floats]:
    """Return caustics, heights and normals as values in [0, 1], brighter caustics above."""
    return {
        "caustic": images["caustic"] / CAUSTIC_WHITE,
        "height": 0.5 + images["height"] / (2.0 * height_range_m),
        "normal": 0.5 + 0.5 * images["normal"],
    }


def world_grid(sea: Sea, size: int, time_s: float) -> tuple[Floats, Floats]:
    """Return height (size, size) [m] and normal (size, size, 3) above the pixel centres of a regular world grid.

    The particles' horizontal shift is undone by iteration, on a periodic cubic spline of the surface.
    """
    from scipy.ndimage import map_coordinates, spline_filter

    grid = _SURFACE_OVERSAMPLING * size
    surface = sea.grid_surface(grid, time_s)
    at = np.arange(grid) * (sea.tile_m / grid)
    shift = [surface.position[..., 0] - at, surface.position[..., 2] - at[:, None]]
    splines = [spline_filter(f, mode="grid-wrap") for f in (*shift, surface.position[..., 1])]
    normals = [spline_filter(surface.normal[..., i], mode="grid-wrap") for i in range(3)]

    def sample(spline: Floats, x: Floats, z: Floats) -> Floats:
        return map_coordinates(spline, [z, x], mode="grid-wrap", prefilter=False)

    to_grid = grid / sea.tile_m
    x, z = np.meshgrid(*(((np.arange(size) + 0.5) * _SURFACE_OVERSAMPLING),) * 2)
    rest_x, rest_z = x, z
    for _ in range(_INVERSIONS):
        rest_x, rest_z = (
            x - to_grid * sample(splines[0], rest_x, rest_z),
            z - to_grid * sample(splines[1], rest_x, rest_z),
        )
    normal = np.stack([sample(n, rest_x, rest_z) for n in normals], axis=-1)
    return sample(splines[2], rest_x, rest_z), normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def _height_range(sea: Sea, loop_s: float) -> float:
    """Return a height [m], of two digits, that the sea stays below all through its loop."""
    times = loop_s * np.arange(16) / 16
    highest = max(float(np.abs(sea.grid_fields(64, t).height).max()) for t in times)
    if highest == 0.0:
        return 1.0
    digit = 10.0 ** (np.floor(np.log10(1.25 * highest)) - 1.0)
    return float(np.ceil(1.25 * highest / digit) * digit)


def _write_png(image: Floats, path: Path) -> None:
    import cv2

    codes = np.round(np.clip(image, 0.0, 1.0) * 65535.0).astype(np.uint16)
    if not cv2.imwrite(str(path), codes[..., ::-1] if codes.shape[-1] == 3 else codes[..., 0]):
        raise VideoError(f"{path} - cannot be written - check the folder's permissions and space")


def _write_exr(image: Floats, path: Path) -> None:
    import OpenEXR

    pixels = np.ascontiguousarray(image, np.float32)
    channels = {"RGB": pixels} if pixels.shape[-1] == 3 else {"Y": pixels[..., 0]}
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))
