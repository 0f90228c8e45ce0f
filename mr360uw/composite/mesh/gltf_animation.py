# SPDX-License-Identifier: Apache-2.0
"""Animations of a glTF file (glTF 2.0 specification, section 3.11)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from mr360uw.composite.mesh.curve import Animation, Channel, Curve, Interpolation, Target
from mr360uw.composite.mesh.gltf import BROKEN, Gltf
from mr360uw.composite.settings import FARTHEST
from mr360uw.errors import MeshError
from mr360uw.types import Floats

_WIDTHS: dict[str, int] = {"translation": 3, "rotation": 4, "scale": 3}
_POINTER = "pointer"
"""Path of channels of KHR_animation_pointer, which move materials, lights and cameras: they are passed over."""
_INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")


@dataclass(frozen=True, slots=True, eq=False)
class ClipReader:
    """Reads clips of a file. place: number in the skeleton of each node; names: of the clips."""

    gltf: Gltf
    place: Mapping[int, int]
    names: tuple[str, ...]

    def __call__(self, number: int) -> Animation:
        """Return a clip; raise `MeshError` where it is broken."""
        try:
            entry = self.gltf.entry("animations", number)
            channels = (self._channel(channel, entry["samplers"], number) for channel in entry["channels"])
            return Animation(self.names[number], tuple(channel for channel in channels if channel is not None))
        except BROKEN as error:
            raise self._broken(number, "is not valid glTF", f"{type(error).__name__}: {error!s:.120}") from error

    def _channel(self, entry: dict[str, Any], samplers: list[dict[str, Any]], number: int) -> Channel | None:
        """Return a channel; None where what it moves is not drawn."""
        target = entry["target"]
        path, node = target["path"], target.get("node")
        if path not in (*_WIDTHS, "weights", _POINTER):
            raise self._broken(number, "moves something unknown", f"path {path!r}")
        if path == _POINTER or node is None:
            return None
        details = self.gltf.entry("nodes", node)
        if node not in self.place:
            return None
        if path == "weights":
            mesh = self.gltf.entry("meshes", details["mesh"]) if "mesh" in details else {"primitives": [{}]}
            width = len(mesh["primitives"][0].get("targets", []))
            if width == 0:
                raise self._broken(number, "moves morph targets of a node that has none", f"node {node}")
        else:
            width = _WIDTHS[path]
            if "matrix" in details:
                raise self._broken(number, "moves a node that is placed by a matrix", f"node {node}")
        curve = self._curve(samplers[entry["sampler"]], width, number, path)
        return Channel(self.place[node], cast("Target", path), curve)

    def _curve(self, sampler: dict[str, Any], width: int, number: int, path: str) -> Curve:
        times = self.gltf.accessor(sampler["input"]).astype(np.float64).ravel()
        kind = sampler.get("interpolation", "LINEAR")
        if kind not in _INTERPOLATIONS:
            raise self._broken(number, "has an interpolation that is unknown", repr(kind))
        if len(times) == 0 or not np.all(np.abs(times) <= FARTHEST) or times[0] < 0.0:
            got = "no keys" if len(times) == 0 else f"{_worst(times) if times[0] >= 0.0 else times[0]:g} s"
            raise self._broken(number, f"has keys of {path} at no time or before 0", got)
        if np.any(np.diff(times) < 0.0):
            at = int(np.argmax(np.diff(times) < 0.0))
            got = f"{times[at]:g} s, then {times[at + 1]:g} s"
            raise self._broken(number, f"has keys of {path} that do not ascend in time", got)
        stored = self.gltf.accessor(sampler["output"]).astype(np.float64)
        parts = 3 if kind == "CUBICSPLINE" else 1
        if stored.size != len(times) * parts * width:
            got = f"{stored.size} numbers for {len(times)} keys of {parts * width}"
            raise self._broken(number, f"has values of {path} that do not fit its keys", got)
        if not np.all(np.abs(stored) <= FARTHEST):
            raise self._broken(number, f"has values of {path} that are not finite or too large", f"{_worst(stored):g}")
        rows = stored.reshape(len(times), parts, width)
        tangents = rows[:, [0, 2]] if parts == 3 else None
        values = rows[:, parts // 2]
        turns = path == "rotation"
        return Curve(
            times, self._unit(values, number) if turns else values, cast("Interpolation", kind), tangents, turns
        )

    def _unit(self, values: Floats, number: int) -> Floats:
        length = np.linalg.norm(values, axis=-1, keepdims=True)
        if not np.all(length > 0.0):
            raise self._broken(number, "has a rotation that is none", "the quaternion 0, 0, 0, 0")
        return values / length

    def _broken(self, number: int, what: str, got: str) -> MeshError:
        name = self.names[number]
        return MeshError(
            f'{self.gltf.path} - animation {name!r} {what} (got {got}) - export it again, or play none (animation = "")'
        )


def _worst(values: Floats) -> float:
    """Return a value that is not finite, or else the largest one."""
    return float(values.ravel()[np.argmax(np.where(np.isfinite(values), np.abs(values), np.inf))])


def clip_names(gltf: Gltf) -> tuple[str, ...]:
    """Return the names of a file's animations; one without a name has its number."""
    return tuple(str(entry.get("name") or number) for number, entry in enumerate(gltf.listed("animations")))
