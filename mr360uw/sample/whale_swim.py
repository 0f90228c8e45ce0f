# SPDX-License-Identifier: Apache-2.0
"""Skeleton of the whale, how its skin follows the joints, and a stroke of swimming that repeats without a jump.

A wave runs down the body. The midline is at the height

    h(s, t) = A(s) cos(2 pi (t / T - (s - s0) / W))

above its height at rest, all lengths in body lengths: T the period, W the wavelength, A(s) growing from the chest s0 to
the flukes, which rise and fall by about a fifth of the length from peak to peak, as those of swimming cetaceans do
(Fish 1998). A joint of the spine turns by the change of the slope dh/ds from one segment to the next, so that the
flukes pitch as they beat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.sample.whale_shape import WhaleSkin, neighbour_means, ramp
from mr360uw.types import Floats

PERIOD_S = 4.0
"""Time of a stroke down and up."""
_KEYS = 24
"""Intervals between keys: straight lines between them miss the wave by less than 1 % of its height."""
_CHEST, _WAVELENGTH = 0.36, 1.25
"""s of the chest, and length of the wave."""
_LEAST, _MOST = 0.005, 0.090
"""Amplitude of the wave at the chest and at the flukes."""
_SPINE = (0.46, 0.56, 0.66, 0.75, 0.83, 0.905)
"""s of the joints behind the chest; the last one moves the flukes."""
_HEAD = 0.26
_Y = 0.010
"""y of the spine."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint. parent: its number, -1 of the root; place: (x, y, z) at rest, in body lengths."""

    name: str
    parent: int
    place: tuple[float, float, float]


def _joints() -> tuple[Joint, ...]:
    chain = [Joint("chest", -1, (0.0, _Y, 0.5 - _CHEST)), Joint("head", 0, (0.0, _Y, 0.5 - _HEAD))]
    for k, s in enumerate(_SPINE):
        name = "flukes" if s == _SPINE[-1] else f"spine {k + 1}"
        chain.append(Joint(name, k + 1 if k else 0, (0.0, _Y, 0.5 - s)))
    flukes = len(chain) - 1
    for side, name in ((1.0, "left"), (-1.0, "right")):
        shoulder = len(chain)
        chain.append(Joint(f"{name} pectoral", 0, (0.085 * side, -0.045, 0.175)))
        chain.append(Joint(f"{name} pectoral tip", shoulder, (0.200 * side, -0.110, 0.090)))
        chain.append(Joint(f"{name} fluke", flukes, (0.060 * side, _Y, -0.470)))
    return tuple(chain)


JOINTS = _joints()
"""The joints, each after its parent."""
_NUMBER = {joint.name: number for number, joint in enumerate(JOINTS)}


def influences(skin: WhaleSkin) -> Floats:
    """Return weights (V, J) with which vertices follow the joints: at most four of a vertex, which sum to 1."""
    weights = np.zeros((len(skin.positions), len(JOINTS)))
    # Along the body each segment takes over from the one before it, smoothly about the joint between them
    s = 0.5 - skin.positions[:, 2]
    starts = [ramp(at - reach, at + reach, s) for at, reach in zip((_HEAD, *_SPINE), (0.08, *_reaches()), strict=True)]
    chain = [_NUMBER["head"], _NUMBER["chest"], *range(2, 2 + len(_SPINE))]
    for number, begun, ended in zip(chain, [np.ones_like(s), *starts], [*starts, np.zeros_like(s)], strict=True):
        weights[:, number] = begun - ended
    # Fins take over from the body, and their tips from them
    for chart in skin.charts[1:]:
        place = np.broadcast_to(chart.place, chart.vertex.shape)[:, 1:]
        for joint, first, last in _FIN_JOINTS.get(chart.name, ()):
            taken, vertex = ramp(first, last, place)[..., None], chart.vertex[:, 1:]
            weights[vertex] *= 1.0 - taken
            weights[vertex, _NUMBER[joint]] += taken[..., 0] * (weights[vertex, _NUMBER[joint]] == 0.0)
    # Let the weights run out into the body about the roots of fins
    means = neighbour_means(skin.faces, len(weights))
    for _ in range(6):
        weights = 0.5 * (weights + means @ weights)
    weights[weights < np.sort(weights, axis=1)[:, -4:-3]] = 0.0
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _reaches() -> Floats:
    """Return half the lengths over which segments of the spine take over from another."""
    return 0.5 * np.diff((_CHEST, *_SPINE))


_FIN_JOINTS = {
    f"{side} {fin}": steps
    for side in ("left", "right")
    for fin, steps in {
        "pectoral": ((f"{side} pectoral", 0.0, 0.3), (f"{side} pectoral tip", 0.3, 0.8)),
        "fluke": ((f"{side} fluke", 0.1, 0.8),),
    }.items()
}
"""Joints of fins, and the fractions of a fin's length between which each takes over."""


@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """Keys (k,) [s] of a cycle, the last one as the first. turns: (k, J, 4) quaternions x, y, z, w of the joints;
    chest: (k, 3) where the chest is, in body lengths.
    """

    time_s: Floats
    turns: Floats
    chest: Floats


def wave(s: Floats, phase: Floats) -> tuple[Floats, Floats]:
    """Return the height of the midline and its slope dh/ds at s, which broadcasts with the phase 2 pi t / T."""
    behind = np.maximum(s - _CHEST, 0.0)
    grown = behind / (1.0 - _CHEST)
    amplitude, growth = _LEAST + (_MOST - _LEAST) * grown**2, 2.0 * (_MOST - _LEAST) * grown / (1.0 - _CHEST)
    number = 2.0 * np.pi / _WAVELENGTH
    angle = phase - number * behind
    return amplitude * np.cos(angle), growth * np.cos(angle) + number * amplitude * np.sin(angle)


def stroke() -> Stroke:
    """Return a cycle of swimming."""
    from scipy.spatial.transform import Rotation

    phase = 2.0 * np.pi * np.arange(_KEYS + 1) / _KEYS
    phase[-1] = 0.0
    # The pitch of a segment is the slope at its middle: (k, segments) from the chest backwards
    ends = np.array([_CHEST, *_SPINE, 1.04])
    middles = np.append(_CHEST, 0.5 * (ends[1:-1] + ends[2:]))
    pitch = np.arctan(wave(middles, phase[:, None])[1])
    angles = np.zeros((_KEYS + 1, len(JOINTS), 3))
    angles[:, 0, 0] = pitch[:, 0]
    angles[:, 2 : 2 + len(_SPINE), 0] = np.diff(pitch, axis=1)
    # The head holds its direction against the chest's
    angles[:, _NUMBER["head"], 0] = -0.8 * pitch[:, 0]
    # The tips of the flukes trail behind their beat; the pectorals rock a little
    beat = np.sin(phase - 2.0 * np.pi * (1.0 - _CHEST) / _WAVELENGTH)
    for side, name in ((1.0, "left"), (-1.0, "right")):
        angles[:, _NUMBER[f"{name} fluke"]] = np.stack([0.08 * beat, 0.0 * beat, 0.16 * side * beat], axis=-1)
        angles[:, _NUMBER[f"{name} pectoral"], 2] = 0.07 * side * np.cos(phase - 0.6)
        angles[:, _NUMBER[f"{name} pectoral tip"], 2] = 0.07 * side * np.cos(phase - 1.5)
    turns = Rotation.from_euler("xyz", angles.reshape(-1, 3)).as_quat().reshape(*angles.shape[:2], 4)
    chest = np.tile(JOINTS[0].place, (_KEYS + 1, 1))
    chest[:, 1] += wave(np.array(_CHEST), phase)[0]
    return Stroke(PERIOD_S * np.arange(_KEYS + 1) / _KEYS, turns, chest)
