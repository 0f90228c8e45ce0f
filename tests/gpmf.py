# SPDX-License-Identifier: Apache-2.0
"""GoPro metadata payloads, written byte by byte after GoPro's description of the format (GPMF introduction).

A record is a key of four letters, a type letter, the size of a sample, the number of samples, big-endian data padded
to four bytes. Containers have type 0 and hold records.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence

import numpy as np


def record(key: str, kind: str, samples: np.ndarray | bytes, size: int = 0) -> bytes:
    """Return one record of big-endian numbers (n, k), or of text or records in `size` bytes each (default 1)."""
    if isinstance(samples, bytes):
        data, size = samples, size or 1
        repeat = len(data) // size
    else:
        data, repeat = samples.tobytes(), len(samples)
        size = len(data) // repeat
    return struct.pack(">4scBH", key.encode(), kind.encode(), size, repeat) + data + bytes(-len(data) % 4)


def container(key: str, *records: bytes) -> bytes:
    """Return a record that holds records."""
    return record(key, "\0", b"".join(records))


def stream(name: str, key: str, scale: int, values: np.ndarray) -> bytes:
    """Return a stream of 16-bit samples (n, k) stored as value times scale."""
    return container(
        "STRM",
        record("STMP", "J", np.array([80577], ">u8")),
        record("TSMP", "L", np.array([len(values)], ">u4")),
        record("STNM", "c", name.encode()),
        record("SCAL", "s", np.array([scale], ">i2")),
        record(key, "s", np.round(values * scale).astype(">i2")),
    )


def payload(up: np.ndarray) -> bytes:
    """Return the payload of frames whose camera sees the world's up towards `up` (n, 3), axes right, up, back.

    Gravity is stored for each frame as the direction down, in axes right, down, forward. The accelerometer is read
    more often and has a scale of its own, the exposure has no scale, and zeros fill the payload up.
    """
    down = -up * [1.0, -1.0, -1.0]
    reading = np.repeat(9.81 * up * [-1.0, 1.0, 1.0], 7, axis=0)[:, [0, 2, 1]]
    exposure = record("SHUT", "f", np.full(len(up), 1.0 / 240.0, ">f4"))
    device = container(
        "DEVC",
        record("DVID", "L", np.array([1], ">u4")),
        record("DVNM", "c", b"a camera"),
        stream("Accelerometer", "ACCL", 417, reading),
        container("STRM", record("STNM", "c", b"Exposure time (shutter speed)"), exposure),
        stream("Gravity Vector", "GRAV", 32767, down),
    )
    return device + bytes(16)


def tilted_up(roll_rad: np.ndarray, pitch_rad: np.ndarray) -> np.ndarray:
    """Return the world's up (n, 3) in the axes right, up, back of cameras turned down to the right, then looking up."""
    return np.stack(
        [-np.sin(roll_rad) * np.cos(pitch_rad), np.cos(roll_rad) * np.cos(pitch_rad), -np.sin(pitch_rad)], axis=1
    )


def payloads(up: np.ndarray, frames: Sequence[int]) -> list[bytes]:
    """Return one payload for each run of so many frames."""
    edges = np.cumsum([0, *frames])
    return [payload(up[a:b]) for a, b in itertools.pairwise(edges)]
