# SPDX-License-Identifier: Apache-2.0
"""Every argument of every public call, given ten wrong values: a result, or an error of the project's own.

Calls are found by the names that the public rooms list, and their good arguments by the names of their parameters:
a new call is tested as soon as it is listed. Good arguments of long computations are such that they are refused late,
before work begins: files that are not there.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw import ibl, surface
from mr360uw.caustics import CausticSettings, GerstnerSea
from mr360uw.errors import Mr360uwError
from mr360uw.match import WaterPatch
from mr360uw.medium import LightField, Medium, Sensor, Water
from mr360uw.types import Sun, View

ROOMS = (
    "mr360uw", "mr360uw.caustics", "mr360uw.composite", "mr360uw.datasets", "mr360uw.depth", "mr360uw.from_above",
    "mr360uw.ibl", "mr360uw.match", "mr360uw.medium", "mr360uw.plot", "mr360uw.sample", "mr360uw.scene",
    "mr360uw.surface", "mr360uw.types", "mr360uw.video",
)  # fmt: skip
WRONG: dict[str, Any] = {
    "None": None, "text": "\0", "5": 5, "-1": -1, "nan": float("nan"), "infinity": float("inf"), "nothing": [],
    "an object": object(), "bytes": b"x", "an array of no shape that fits": np.zeros((3, 5, 7)),
}  # fmt: skip


def public_calls() -> dict[str, Callable[..., Any]]:
    """Return functions, classes and class methods of the public rooms, and methods of good objects, by name."""
    found: dict[str, Callable[..., Any]] = {}
    for room in ROOMS:
        module = importlib.import_module(room)
        for name in getattr(module, "__all__", vars(module)):
            call = getattr(module, name)
            own = hasattr(module, "__all__") or getattr(call, "__module__", "") == room
            if name.startswith("_") or not own:
                continue
            if inspect.isfunction(call):
                found[name] = call
            elif inspect.isclass(call) and not issubclass(call, Exception) and not _holds_alone(call):
                found[name] = call
                found |= {
                    f"{name}.{of}": getattr(call, of)
                    for of, one in vars(call).items()
                    if isinstance(one, classmethod) and not of.startswith("_")
                }
    for good in OBJECTS:
        methods = {
            of: one
            for kind in type(good).__mro__
            if kind.__module__.startswith("mr360uw")
            for of, one in vars(kind).items()
            if inspect.isfunction(one) and not of.startswith("_")
        }
        found |= {f"{type(good).__name__}.{of}": getattr(good, of) for of in methods}
    return found


def _holds_alone(kind: type) -> bool:
    """Return whether a class is a protocol, or only holds what it is given: a result."""
    held = issubclass(kind, tuple) or (dataclasses.is_dataclass(kind) and not hasattr(kind, "__post_init__"))
    return bool(getattr(kind, "_is_protocol", False)) or (held and not hasattr(kind.__init__, "__wrapped__"))


UP = np.array([0.0, 1.0, 0.0])
W = np.array([450.0, 550.0, 600.0, 650.0])
COEFFICIENT = np.full(4, 0.3)
IMAGE = np.full((32, 64, 3), 0.3, np.float32)
SUN = Sun(UP, np.ones(3), 0.01, 1.0)
WATER = Water.jerlov("IB")
FIELD = LightField(COEFFICIENT, COEFFICIENT, "isotropic")
MEDIUM = Medium(WATER, mode="kd", band_count=4)
SEA = GerstnerSea(wave_count=4)
STILL = uw.CameraTrack(
    "still", np.zeros(1), np.zeros((1, 3)), np.eye(3)[None], np.zeros(1), np.zeros(1), np.zeros(1, int),
    np.zeros((0, 3)), np.zeros(0), 0.0, 64, None, "up", "scale",
)  # fmt: skip
"""A track without points, which shows no floor and no distances."""
EYE = uw.depth.Panorama(np.zeros((32, 64), np.float32), np.zeros(3), np.eye(3))
SCENE = uw.Scene.model_validate({"plate": {"path": "nowhere.mp4"}, "object": [{"mesh": "nowhere.glb"}]})
ENVIRONMENT = ibl.environment(IMAGE)
SUNS = ibl.track_suns([SUN] * 3, [0.0, 1.0, 2.0])
STACK = uw.CausticStack(np.ones((2, 16, 16)), np.array([1.0, 2.0]), 4.0, UP)
VIEW = View(16, 8)
PAINTED = uw.Layer(8, 16, ())
LEVEL_FLOOR = surface.Floor(-3.0, 0.3)
GOOD: dict[str, Any] = {
    "absorption": COEFFICIENT, "after": IMAGE, "albedo": 0.3, "albedo_rgb": np.full(3, 0.3), "all_settings": (),
    "before": IMAGE, "camera_depth_m": 5.0, "channels": IMAGE, "clip": "nowhere.mp4", "confidence": np.zeros((32, 64)),
    "cos_air": COEFFICIENT, "count": 4, "depth_m": 3.0, "depths_m": [2.0, 3.0], "direction": UP,
    "direction_in_air": UP, "direction_in_water": UP, "distance_m": 2.0, "dome": IMAGE, "environment": ENVIRONMENT,
    "exposure": np.ones(3), "far_m": 5.0, "field": FIELD, "file": "nowhere.mp4", "fit": np.mean,
    "floor": (-3.0, 0.3), "folder": "there.txt/folder", "frame_rate": 30.0, "frames": [1.0, 2.0],
    "gains": np.ones((3, 3)),
    "height": 8, "height_m": -3.0, "irradiance": np.ones(3), "layers": "nowhere_%d.exr", "left": np.zeros((32, 64)),
    "like": None, "measurements": [SUN] * 3, "medium": MEDIUM, "mode": "kd", "amplitude_m": 1e-3,
    "angle_deg": [0.0, 180.0], "azimuth_deg": 0.0, "azimuth_rad": 0.1, "data": {}, "gain": np.ones(3),
    "image_linear": IMAGE, "mg_m3": 0.3, "moment": [1.0], "most": 2, "n": 4, "normal_up": 0.3, "one": IMAGE[..., 0],
    "other": IMAGE[..., 0], "part": None, "parts": IMAGE, "patch": WaterPatch(0.0, 10.0, 20.0), "pattern_m": 1.0,
    "phase_rad": 0.0, "response": np.full((4, 3), 0.3), "rows": 8, "columns": 16, "slices": 4,
    "source": "nowhere.mp4", "steepness": 0.5, "tile_m": 8.0, "value": [1.0, 1.0], "water_type": "IB",
    "wave_vector": np.ones((3, 2)), "width": 64, "index": 0, "y": 0.5, "shot": None, "tile": None, "yuv": None,
    "metadata": None, "error": None, "n_dot_v": 0.5, "name": "D65", "values": {"camera.depth_m": [3.0]},
    "near_m": 2.0, "neighbours": (), "out": "there.txt/out.mp4", "path": "there.txt/nowhere.csv", "picture": None,
    "plate": IMAGE, "plate_linear": IMAGE, "radiance": IMAGE, "radiance_map": IMAGE, "reference": EYE,
    "refractive_index": 1.34, "result": STACK, "rgb": np.ones(3), "right": np.zeros((32, 64)), "roughness": 0.5,
    "scattering": COEFFICIENT, "scene": SCENE, "sea": SEA, "stack": STACK, "sun": SUN, "sun_direction_in_air": UP,
    "time_s": 0.0, "top_m": [0.0], "track": STILL, "up": 0.2, "video": "nowhere.mp4", "view": VIEW, "water": WATER,
    "wavelength_nm": W, "dataset": None, "phase": "isotropic", "size": 16, "grid": 8,
}  # fmt: skip
"""Good arguments by name."""


SMALL = CausticSettings(size=16, grid=8)
OWN: dict[str, dict[str, Any]] = {
    "caustic_map": {"size": 16, "grid": 8}, "caustic_stack": {"settings": SMALL},
    "picture": {"sea": GerstnerSea(wind_speed=0.0), "view": View(4, 2), "samples": 1}, "Dive": {"settings": None},
    "load_object": {"settings": uw.composite.ObjectSettings(mesh="nowhere.glb")},
    "load_receiver": {"settings": uw.composite.ReceiverSettings(kind="mesh", path="nowhere.glb")},
    "ObjectSettings": {"mesh": "nowhere.glb"}, "Water": {"a": WATER.a, "b": WATER.b},
    "WaterPatch": {"yaw_deg": 0.0, "pitch_deg": 0.0, "size_deg": 9.0},
    "check_recording": {"width": 64, "frames": 1, "samples": 1}, "transcode": {"target": "there.txt/out.mp4"},
    "export_tiles": {"settings": SMALL},
    "of_caustics": {"stack": uw.CausticStack(np.ones((2, 16, 16, 3)), np.array([1.0, 2.0]), 4.0, UP)},
    "render_frame": {"backend": "reference"}, "sweep": {"backend": "reference"}, "Compositor": {"backend": "reference"},
}  # fmt: skip
"""Good arguments of single calls, where those of other calls with the same name differ, or the default takes long."""
OBJECTS: tuple[Any, ...] = (WATER, Sensor.cie1931(), FIELD, STILL, uw.Compositor(SCENE, backend="reference"))
"""Objects whose methods are called."""


def good_arguments(name: str, call: Callable[..., Any]) -> dict[str, Any]:
    """Return good values of the arguments that a call needs."""
    own = OWN.get(name, {})
    needed = [one for one, default in arguments_of(call).items() if default is inspect.Parameter.empty]
    return {one: GOOD[one] for one in needed if one not in own} | own


def arguments_of(call: Callable[..., Any]) -> dict[str, Any]:
    """Return the named arguments of a call, with their default values."""
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return {n: one.default for n, one in inspect.signature(call).parameters.items() if one.kind not in several}


def consume(call: Callable[..., Any], arguments: dict[str, Any]) -> None:
    """Call, and go to the first result of a generator."""
    result = call(**arguments)
    if inspect.isgenerator(result):
        next(result, None)
        result.close()


def refused_otherwise(call: Callable[..., Any], arguments: dict[str, Any]) -> str:
    """Return what is raised instead of an error of the project's own; "" for such an error, or a result."""
    try:
        consume(call, arguments)
    except Mr360uwError as error:
        return "" if " - " in str(error) else f"{type(error).__name__} without a remedy: {error}"
    except Exception as error:  # noqa: BLE001 - what is looked for
        return f"{type(error).__name__}: {error!s:.80}"
    return ""


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_every_argument_of_every_public_call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.txt").touch()
    wrong = [
        f"{name}({argument} = {kind}) - {problem}"
        for name, call in public_calls().items()
        for good in [good_arguments(name, call)]
        for argument in arguments_of(call)
        for kind, value in WRONG.items()
        if (problem := refused_otherwise(call, good | {argument: value}))
    ]
    assert wrong == []
    assert [path.name for path in tmp_path.iterdir()] == ["there.txt"]
