# SPDX-License-Identifier: Apache-2.0
"""Random legal scenes with their plates, meshes, mattes and tables: a seed makes the same files always.

Numbers and words are drawn from the parameter models, whose ranges and choices they declare. What a model refuses in
combination (a place given twice, a sun below the horizon) is drawn here so that it fits together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import cv2
import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mr360uw.base.color import encode
from mr360uw.base.parameters import bounds_of
from mr360uw.caustics.gerstner import GerstnerSea
from mr360uw.caustics.settings import CausticSettings
from mr360uw.caustics.spectral import SpectralSea
from mr360uw.composite.grading.settings import MatchSettings
from mr360uw.composite.settings import (
    DrawSettings,
    HoldoutSettings,
    LampSettings,
    ObjectSettings,
    ReceiverSettings,
    SnowSettings,
)
from mr360uw.ibl import LightSettings
from mr360uw.medium import WaterSettings
from mr360uw.medium.settings import ShaftSettings
from mr360uw.medium.spectra import cameras
from mr360uw.sample.dive import write_whale
from mr360uw.scene.model import CameraSettings, Scene, scene_from_dict
from mr360uw.video.exr import write_exr
from tests.composite.gltf_files import tube
from tests.video.clips import fill

WIDTH, HEIGHT, FRAMES = 256, 128, 2
DRAWN = 0.35
"""Probability that a parameter is drawn; the others keep their defaults."""
AT_AN_END = 0.1
"""Probability that a number is one of the ends of its range."""
SWAY_M = 0.5
"""Height [m] that a camera's track sways by."""
LIMITS: dict[str, tuple[float, float]] = {
    "samples": (1, 17), "sun_samples": (1, 8), "motion_samples": (1, 3), "planes": (1, 4), "bands": (1, 32),
    "resolution": (16, 128), "slices": (4, 12), "wave_count": (1, 48), "grid": (4, 96), "tile_m": (0.2, 60.0),
    "amount": (0.0, 30.0), "range_m": (0.2, 100.0), "exposure": (-4.0, 4.0), "lumen": (0.0, 2e4), "speed": (-4.0, 4.0),
    "start_s": (-10.0, 10.0), "azimuth_deg": (-180.0, 180.0), "face": (-180.0, 180.0),
}  # fmt: skip
"""Ranges of numbers that have none, or whose whole range takes long or shows nothing."""
LEFT_OUT = {
    "path", "mesh", "csv", "track", "gravity", "texture", "key", "tilt_keys", "depth_keys", "explicit_waves", "patch",
    "illuminant", "animation", "size", "outside_files", "waves_of_wind_speed", "waves_of_wind_deg", "sun_time",
    "place_deg", "depth_m", "smooth", "quality", "rough", "position_m", "azimuth_deg", "elevation_deg", "distance_m",
    "stand_on", "attach", "size_m", "scale", "sizes_mm", "kind", "height_m", "range_m", "phase", "type", "black",
    "white", "gamma", "invert", "current_m_s",
}  # fmt: skip
"""Parameters that name files, that decide on others, or that are drawn together."""

Random = np.random.Generator
Table = dict[str, Any]


@dataclass(frozen=True, slots=True)
class RandomScene:
    """The scene of a seed, as the nested tables of its file in a folder."""

    seed: int
    data: Table
    folder: Path

    def scene(self) -> Scene:
        """Return the scene; raise `SceneError` where it is not legal after all."""
        return scene_from_dict(self.data, self.folder)


def random_scene(seed: int, folder: Path) -> RandomScene:
    """Return the scene of a seed, its files written into a folder."""
    rng = np.random.default_rng((360, seed))
    files = Files(folder, rng)
    wet = rng.random() < 0.9
    depth_m = _log(rng, 0.05, 200.0) if rng.random() < 0.3 else _log(rng, 0.5, 30.0)
    eye = rng.choice(["left", "right", "both"]) if rng.random() < 0.15 else None
    camera, sinks_m = _camera(rng, files, depth_m)
    data: Table = {
        "plate": files.plate(eye),
        "camera": camera,
        "water": _water(rng, files) if wet else {"type": "none"},
        "light": _light(rng),
        "sea": _sea(rng),
        "caustics": table(CausticSettings, rng) | {"size": int(2 ** rng.integers(4, 8)), "grid": 48},
        "shafts": table(ShaftSettings, rng) | {"resolution": 64, "slices": 8},
        "draw": {"samples": 5} | table(DrawSettings, rng),
    }  # fmt: skip
    receiver = _receiver(rng, files, eye, sinks_m)
    if receiver is not None:
        data["receiver"] = receiver
    objects = [_object(rng, files, depth_m, receiver, eye) for _ in range(int(rng.integers(1, 4)))]
    data["object"] = objects
    if rng.random() < 0.3:
        data["lamp"] = [_lamp(rng, len(objects)) for _ in range(int(rng.integers(1, 3)))]
    if rng.random() < 0.25:
        data["holdout"] = [_holdout(rng, files, eye)]
    if rng.random() < 0.35:
        data["snow"] = _snow(rng)
    if rng.random() < 0.3:
        data["match"] = _match(rng)
    data["surface"] = {"objects": "none" if eye == "both" else str(rng.choice(["auto", "auto", "all", "none"]))}
    if rng.random() < 0.2:
        data["keys"] = _keys(rng, data)
    return RandomScene(seed, data, folder)


# --- values of one model ---------------------------------------------------------------------------------------------


def table(model: type[BaseModel], rng: Random, share: float = DRAWN) -> Table:
    """Return random values of some of a model's parameters."""
    values = {}
    for name, field in model.model_fields.items():
        if name not in LEFT_OUT and rng.random() < share:
            values[field.alias or name] = _value(field.annotation, _range(name, field), name, rng)
    return {name: value for name, value in values.items() if value is not None}


def _range(name: str, field: FieldInfo) -> tuple[float, float]:
    """Return the range that numbers of a field are drawn from."""
    low, high = bounds_of(field)
    if name in LIMITS:
        least, most = LIMITS[name]
        return max(least, least if low is None else low), min(most, most if high is None else high)
    least = -50.0 if low is None else low
    return least, least + 100.0 if high is None else high


def _value(kind: Any, span: tuple[float, float], name: str, rng: Random) -> Any:
    """Return a value of a type: a number of a range, a word, a switch, or a vector of such."""
    if kind is bool:
        return bool(rng.random() < 0.5)
    if kind is int:
        return int(rng.integers(int(span[0]), int(span[1]) + 1))
    if kind is float:
        return _number(span, rng)
    if get_origin(kind) is Literal:
        words = [c for c in get_args(kind) if not isinstance(c, int) or c <= LIMITS.get(name, (0, c))[1]]
        return words[rng.integers(len(words))]
    if get_origin(kind) is tuple:
        low = 0.0 if name in ("color", "base_color", "tint", "gain") else span[0]
        return [_value(float, (low, 2.0 if low == 0.0 else span[1]), name, rng) for _ in get_args(kind)]
    parts = [part for part in get_args(kind) if part not in (type(None), Path, str)]
    if hasattr(kind, "__metadata__"):
        rules = FieldInfo.from_annotation(kind)
        return _value(kind.__origin__, _range(name, rules), name, rng)
    return _value(parts[rng.integers(len(parts))], span, name, rng) if parts else None


def _number(span: tuple[float, float], rng: Random) -> float:
    low, high = span
    least = low + 1e-6 * (high - low)  # a range may leave its low end out
    if rng.random() < AT_AN_END:
        return (least, high)[rng.integers(2)]
    if low >= 0.0 and high > 100.0 * max(low, 1e-3):
        return _log(rng, max(least, 1e-3 * high), high)
    return float(rng.uniform(least, high))


def _log(rng: Random, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _vector(rng: Random, reach: float) -> list[float]:
    return [float(x) for x in rng.uniform(-reach, reach, 3)]


# --- tables of a scene -----------------------------------------------------------------------------------------------


def _camera(rng: Random, files: Files, depth_m: float) -> tuple[Table, float]:
    """Return the camera, and how far [m] it sinks from its start."""
    found: Table = {"depth_m": depth_m}
    kind, sinks_m = rng.integers(8), 0.0
    if kind == 0:
        deepest_m = min(depth_m * float(rng.uniform(0.5, 2.0)), 200.0)
        found["depth_keys"], sinks_m = [[0.0, depth_m], [0.02, deepest_m]], max(deepest_m - depth_m, 0.0)
    elif kind == 1:
        found["track"], sinks_m = files.track(depth_m), SWAY_M
    elif kind == 2:
        found |= {"roll_deg": float(rng.uniform(-30, 30)), "pitch_deg": float(rng.uniform(-30, 30))}
    elif kind == 3:
        found["tilt_keys"] = [[0.0, *_vector(rng, 20.0)[:2]], [0.05, *_vector(rng, 20.0)[:2]]]
    return found | {k: v for k, v in table(CameraSettings, rng).items() if k == "ipd_m"}, sinks_m


def _water(rng: Random, files: Files) -> Table:
    found = table(WaterSettings, rng)
    kinds = [kind for part in get_args(WaterSettings.model_fields["type"].annotation) for kind in _words(part)]
    kind = str(rng.choice([k for k in kinds if k != "none"]))
    found["type"] = kind
    if kind == "csv":
        found["csv"] = files.water()
    if rng.random() < 0.25:
        phase = rng.integers(5)
        found["phase"] = (
            str(rng.choice(["petzold", "isotropic", "water"])), float(rng.uniform(-0.95, 0.99)),
            [float(rng.uniform(1.01, 1.35)), float(rng.uniform(3.05, 4.95))], files.phase(), "auto",
        )[phase]  # fmt: skip
    if rng.random() < 0.2:
        found["sensor"] = "CIE 1931" if rng.random() < 0.3 else str(rng.choice(cameras()))
    else:
        found.pop("sensor", None)
    return found


def _words(kind: Any) -> list[str]:
    return [kind] if isinstance(kind, str) else [word for part in get_args(kind) for word in _words(part)]


def _light(rng: Random) -> Table:
    found = table(LightSettings, rng)
    if found.get("sun") == "date":  # at noon of the place
        longitude = float(rng.uniform(-165.0, 165.0))
        hour = 12.0 - longitude / 15.0
        day = f"2026-{rng.integers(1, 13):02d}-{rng.integers(1, 28):02d}"
        found["sun_time"] = f"{day}T{int(hour):02d}:{int(60 * (hour % 1)):02d}:00+00:00"
        found["place_deg"] = [float(rng.uniform(-50.0, 50.0)), longitude]
    return found


def _sea(rng: Random) -> Table:
    kind, model = (("gerstner", GerstnerSea), ("spectral", SpectralSea))[rng.integers(2)]
    return table(model, rng, 0.25) | {"model": kind}


def _place(rng: Random, depth_m: float) -> Table:
    """Return a place: around the camera, at the water's surface, far away, or at the camera."""
    if rng.random() < 0.25:
        return {"azimuth_deg": float(rng.uniform(-180, 180)), "elevation_deg": float(rng.uniform(-60, 60)),
                "distance_m": _log(rng, 0.5, 20.0)}  # fmt: skip
    direction = rng.normal(size=3) * [1.0, 0.5, 1.0]
    place = direction / np.linalg.norm(direction) * _log(rng, 0.3, 30.0)
    if rng.random() < 0.2:
        place[1] = depth_m + rng.uniform(-0.5, 0.5)
    return {"position_m": [float(x) for x in place]}


def _object(rng: Random, files: Files, depth_m: float, receiver: Table | None, eye: str | None) -> Table:
    found = table(ObjectSettings, rng, 0.2) | {"mesh": files.mesh()} | _place(rng, depth_m)
    found |= {"size_m" if rng.random() < 0.7 else "scale": _log(rng, 0.05, 8.0)}
    position = found.get("position_m")
    if receiver is not None and receiver["kind"] == "plane" and position is not None and rng.random() < 0.5:
        found["stand_on"] = "receiver"
    elif rng.random() < 0.15:
        found["attach"] = "camera"
    elif position is not None and rng.random() < 0.15 and eye != "both":
        found |= {"attach": "surface", "position_m": [position[0], float(rng.uniform(-0.3, 0.3)), position[2]]}
    if "attach" not in found and rng.random() < 0.25:
        keys = [{"time_s": 0.0}, {"time_s": 0.05, "rotation_deg": _vector(rng, 90.0)}]
        if "position_m" in found and "stand_on" not in found:
            keys[1]["position_m"] = [float(a + b) for a, b in zip(found["position_m"], _vector(rng, 0.3), strict=True)]
        found["key"] = keys
    return found


def _receiver(rng: Random, files: Files, eye: str | None, sinks_m: float) -> Table | None:
    kind = rng.choice(["none", "plane", "plane", "mesh", "height_map", "distance"])
    if kind == "none":
        return None
    found = table(ReceiverSettings, rng) | {"kind": str(kind)}
    if kind == "plane":
        found["height_m"] = -(sinks_m + _log(rng, 0.1, 20.0))
    elif kind == "mesh":
        found |= {"path": files.ground(), "position_m": [0.0, -_log(rng, 1.0, 6.0), 0.0]}
    elif kind == "height_map":
        found |= {"path": files.heights(), "position_m": [0.0, -_log(rng, 2.0, 6.0), 0.0]}
    else:
        found |= {"path": files.distances(eye), "range_m": [0.0, _log(rng, 5.0, 40.0)]}
    return found


def _lamp(rng: Random, objects: int) -> Table:
    attach: str | int = (str(rng.choice(["world", "camera"])), int(rng.integers(objects)))[rng.random() < 0.2]
    return table(LampSettings, rng) | {"position_m": _vector(rng, 3.0), "attach": attach}


def _holdout(rng: Random, files: Files, eye: str | None) -> Table:
    if rng.random() < 0.5:
        return {"path": files.mask(eye), "invert": bool(rng.random() < 0.3)}
    return table(HoldoutSettings, rng) | {"path": files.distances(eye), "kind": "distance", "range_m": [0.0, 20.0]}


def _snow(rng: Random) -> Table:
    low, high = sorted(_log(rng, 0.3, 50.0) for _ in range(2))  # smaller ones are millions
    return table(SnowSettings, rng) | {
        "amount": _log(rng, 0.1, 10.0), "range_m": _log(rng, 0.2, 4.0), "sizes_mm": [low, min(1.2 * high, 50.0)],
        "current_m_s": _vector(rng, 0.5),
    }  # fmt: skip


def _match(rng: Random) -> Table:
    found = table(MatchSettings, rng)
    if rng.random() < 0.6:
        found |= {"black": float(rng.uniform(0.0, 0.1)), "white": float(rng.uniform(0.85, 1.1))}
    if rng.random() < 0.4:
        found["gamma"] = float(rng.uniform(0.8, 1.3))
    return found


_KEYED: dict[str, tuple[str, float, float]] = {
    "sea.wind_speed": ("sea", 0.0, 15.0), "light.exposure": ("light", -2.0, 2.0), "water.shade": ("water", 0.0, 1.0),
    "shafts.strength": ("shafts", 0.0, 2.0), "draw.grain": ("draw", 0.0, 2.0), "water.sun_share": ("water", 0.0, 1.0),
    "object.0.exposure": ("object", -2.0, 2.0), "object.0.roughness": ("object", 0.0, 1.0),
}  # fmt: skip
"""Parameters that are keyed, with the range of their values."""


def _keys(rng: Random, data: Table) -> list[Table]:
    names = rng.choice([name for name, (of, *_) in _KEYED.items() if of in data], 2, replace=False)
    keyed = []
    for name in map(str, names):
        table_of, low, high = _KEYED[name]
        owner, last = (data["object"][0] if table_of == "object" else data[table_of]), name.rpartition(".")[2]
        owner.setdefault(last, float(rng.uniform(low, high)))
        keyed.append({"parameter": name, "time_s": [0.0, 0.05], "value": [float(x) for x in rng.uniform(low, high, 2)]})
    return keyed


# --- files -----------------------------------------------------------------------------------------------------------


class Files:
    """The files of a scene, made in a folder."""

    def __init__(self, folder: Path, rng: Random) -> None:
        self._folder, self._rng = folder, rng

    def _path(self, name: str, make: Callable[[Path], object]) -> str:
        """Return a file that scenes share, made once."""
        path = self._folder / name
        if not path.exists():
            make(path)
        return str(path)

    def mesh(self) -> str:
        """Return a mesh: a whale, a box, a ball, or a tube that bends."""
        import trimesh

        makers: dict[str, Callable[[Path], object]] = {
            "whale.glb": lambda path: write_whale(path, 4.0, detail="low"), "box.obj": trimesh.creation.box().export,
            "ball.ply": trimesh.creation.icosphere(subdivisions=2).export, "tube.glb": lambda path: tube().write(path),
        }  # fmt: skip
        name = str(self._rng.choice(list(makers)))
        return self._path(name, makers[name])

    def ground(self) -> str:
        """Return a mesh of the floor: a bumpy square 20 m wide."""
        return self._path("ground.obj", _write_ground)

    def heights(self) -> str:
        """Return a height map."""
        return self._path("heights.png", lambda path: _write_png(path, _smooth(3, 64, 64)[..., 0], 16))

    def distances(self, eye: str | None) -> str:
        """Return a distance map of the plate's shape, a part of it without surface."""
        rows = HEIGHT * (2 if eye == "both" else 1)
        values = _smooth(5, rows, WIDTH)[..., 0]
        values[: rows // 5] = 0.0
        return self._path(f"distances-{rows}.png", lambda path: _write_png(path, values, 16))

    def mask(self, eye: str | None) -> str:
        """Return a matte."""
        rows = HEIGHT * (2 if eye == "both" else 1)
        values = np.clip(4.0 * _smooth(7, rows, WIDTH)[..., 0] - 1.5, 0.0, 1.0)
        return self._path(f"mask-{rows}.png", lambda path: _write_png(path, values, 8))

    def track(self, depth_m: float) -> str:
        """Return a camera track that sways and turns below the surface."""
        path, rng = self._folder / f"track-{rng_name(self._rng)}.csv", self._rng
        rows = ["time_s,x,y,z,qx,qy,qz,qw"]
        for time in (0.0, 0.1, 1.0):
            x, y, z = (
                0.3 * rng.uniform(-1, 1),
                min(SWAY_M, 0.5 * depth_m) * rng.uniform(-1, 1),
                0.3 * rng.uniform(-1, 1),
            )
            turn = rng.normal(size=4) * [0.1, 0.3, 0.1, 0.0] + [0.0, 0.0, 0.0, 1.0]
            rows.append(",".join(f"{v:.9f}" for v in (time, x, y, z, *(turn / np.linalg.norm(turn)))))
        path.write_text("\n".join(rows) + "\n")
        return str(path)

    def water(self) -> str:
        """Return a table of absorption and scattering."""
        path, rng = self._folder / f"water-{rng_name(self._rng)}.csv", self._rng
        nm = np.arange(400, 701, 20)
        a = _log(rng, 0.02, 1.0) * (1.0 + rng.uniform(0.0, 3.0) * ((nm - 480.0) / 200.0) ** 2)
        b = _log(rng, 0.01, 2.0) * (550.0 / nm) ** rng.uniform(0.0, 2.0)
        lines = [f"{n},{x:.6g},{y:.6g}" for n, x, y in zip(nm, a, b, strict=True)]
        path.write_text("wavelength_nm,absorption,scattering\n" + "\n".join(lines) + "\n")
        return str(path)

    def phase(self) -> str:
        """Return a table of a phase function: Henyey-Greenstein's, from nearly even to steep."""
        path, g = self._folder / f"phase-{rng_name(self._rng)}.csv", 1.0 - _log(self._rng, 0.005, 1.0)
        angle = np.concatenate([[0.05], np.geomspace(0.1, 180.0, 60)])
        value = (1.0 - g * g) / (1.0 + g * g - 2.0 * g * np.cos(np.radians(angle))) ** 1.5
        lines = [f"{x:.6g},{y:.6g}" for x, y in zip(angle, value, strict=True)]
        path.write_text("angle_deg,phase_function\n" + "\n".join(lines) + "\n")
        return str(path)

    def plate(self, eye: str | None) -> Table:
        """Return the table of a plate: a still or a video of 8 or 10 bits, of standard or high dynamic range."""
        images = [_light_of_plate(self._rng) for _ in range(1 if eye is None else 2)]
        light = np.concatenate(images)
        names = list(_CLIPS) if self._rng.random() < 0.7 else ["png8", "png16", "exr"]
        kind = str(self._rng.choice(names))
        path = self._folder / f"plate-{rng_name(self._rng)}"
        if kind == "exr":
            path = path.with_suffix(".exr")
            if self._rng.random() < 0.3:
                light = light - np.float32(0.02)
            write_exr(path, light)
        elif kind.startswith("png"):
            path = path.with_suffix(".png")
            _write_png(path, encode(np.clip(light, 0.0, 1.0), "srgb"), int(kind[3:]))
        else:
            path = path.with_suffix(".mp4" if _CLIPS[kind][0] != "ffv1" else ".mkv")
            _write_clip(path, light, *_CLIPS[kind])
        return {"path": str(path)} | ({} if eye is None else {"eye": str(eye), "layout": "top-bottom"})


def rng_name(rng: Random) -> str:
    """Return a name for a file of one scene."""
    return f"{rng.integers(1 << 62):x}"


_CLIPS: dict[str, tuple[str, str, tuple[int, int, int, int]]] = {
    "h264": ("libx264", "yuv420p", (1, 1, 1, 1)), "h265": ("libx265", "yuv420p10le", (1, 1, 1, 1)),
    "pq": ("libx265", "yuv420p10le", (1, 9, 9, 16)), "hlg": ("libx265", "yuv420p10le", (1, 9, 9, 18)),
    "422": ("ffv1", "yuv422p10le", (1, 1, 1, 1)), "444": ("ffv1", "yuv444p", (2, 1, 1, 1)),
}  # fmt: skip
"""Codec, pixel format and tags (range, matrix, primaries, transfer of H.273) of videos."""


def _write_clip(path: Path, light: np.ndarray, codec: str, pixels: str, tags: tuple[int, int, int, int]) -> None:
    """Write a video of two frames of a picture, the second a little brighter, its codes up to the ends of the range."""
    import av

    height, width = light.shape[:2]
    bits = 10 if "10le" in pixels else 8
    step, kind = 2 ** (bits - 8), np.uint8 if bits == 8 else np.uint16
    code = np.clip(encode(np.clip(light, 0.0, 1.0), "srgb"), 0.0, 1.0)
    luma = code @ [0.2126, 0.7152, 0.0722]
    chroma = ((code[..., 2] - luma) / 1.8556, (code[..., 0] - luma) / 1.5748)
    across, down = (1 if "444" in pixels else 2), (2 if "420" in pixels else 1)
    chroma = [c.reshape(height // down, down, width // across, across).mean(axis=(1, 3)) for c in chroma]
    quiet = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    with av.open(str(path), "w") as container:
        speed = {} if codec == "ffv1" else {"preset": "ultrafast", "bf": "0"}
        stream = container.add_stream(codec, rate=30, options=quiet | speed)
        context = stream.codec_context
        context.width, context.height, context.pix_fmt = width, height, pixels
        context.time_base = Fraction(1, 30)
        context.color_range, context.colorspace, context.color_primaries, context.color_trc = tags
        for index in range(FRAMES):
            planes = [16.0 + 219.0 * luma * (0.97 + 0.03 * index), *(128.0 + 224.0 * c for c in chroma)]
            frame = av.VideoFrame(width, height, pixels)
            fill(frame, [np.round(step * plane).astype(kind) for plane in planes])
            frame.pts, frame.time_base = index, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _light_of_plate(rng: Random) -> np.ndarray:
    """Return the light (H, W, 3) of a plate: water with a sun, noise, one colour, black, or far above white."""
    kind, up = rng.integers(7), np.linspace(1.0, 0.0, HEIGHT)[:, None, None]
    water = (0.02 + up**2) * rng.random(3) * [0.3, 1.0, 1.0] * np.ones((1, WIDTH, 1))
    if kind <= 2:
        row, column = rng.integers(0, HEIGHT // 2), rng.integers(0, WIDTH)
        y, x = np.mgrid[:HEIGHT, :WIDTH]
        glare = np.exp(-((y - row) ** 2 + (x - column) ** 2) / _log(rng, 2.0, 100.0))
        water = water + _log(rng, 0.5, 20.0) * glare[..., None] + 0.1 * _smooth(int(rng.integers(99)), HEIGHT, WIDTH)
    elif kind == 3:
        water = rng.random((HEIGHT, WIDTH, 3)) ** 3
    elif kind == 4:
        water = np.broadcast_to(rng.random(3) ** 2, (HEIGHT, WIDTH, 3))
    elif kind == 5:
        water = np.zeros((HEIGHT, WIDTH, 3))
    else:
        water = np.exp(rng.normal(-1.0, 1.5, (HEIGHT, WIDTH, 3)))
    noise = 0.01 * rng.random() * rng.normal(size=water.shape) * np.sqrt(np.maximum(water, 1e-4))
    return np.maximum(water + (noise if kind != 5 else 0.0), 0.0).astype(np.float32)


def _smooth(seed: int, rows: int, columns: int) -> np.ndarray:
    """Return a smooth random picture (rows, columns, 3) in [0, 1]."""
    coarse = np.random.default_rng(seed).random((6, 10, 3)).astype(np.float32)
    return np.clip(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC), 0.0, 1.0)


def _write_png(path: Path, values: np.ndarray, bits: int) -> None:
    codes = np.round(np.clip(values, 0.0, 1.0) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    cv2.imwrite(str(path), codes[..., ::-1] if codes.ndim == 3 else codes)


def _write_ground(path: Path) -> None:
    import trimesh

    side = np.linspace(-10.0, 10.0, 24)
    x, z = np.meshgrid(side, side)
    points = np.stack([x, 0.3 * np.sin(x) * np.cos(0.7 * z), z], axis=-1).reshape(-1, 3)
    at = np.arange(24 * 24).reshape(24, 24)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    faces = np.concatenate([np.stack([a, d, c], 1), np.stack([a, c, b], 1)])
    trimesh.Trimesh(points, faces, process=False).export(path)
