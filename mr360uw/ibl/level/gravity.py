# SPDX-License-Identifier: Apache-2.0
"""Parses GoPro metadata (GPMF): nested key-length-value records, and the scaled samples of one stream.

A record is FourCC, type character, sample size (u8), repeat (u16), data padded to 4 bytes, big-endian; type 0 holds
records. A stream (STRM) states a divisor (SCAL) before its samples (GoPro, gpmf-parser).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError

_NUMBERS = {
    "b": ">i1", "B": ">u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8", "j": ">i8",
    "J": ">u8",
}  # fmt: skip

_DEEPEST = 16
"""Most records within each other; cameras write three."""


@dataclass(frozen=True, slots=True)
class Record:
    """One key-length-value record: `children` of a container, else `data` of `repeat` samples of `size` bytes."""

    key: str
    type: str
    size: int
    repeat: int
    data: bytes
    children: tuple[Record, ...] = ()

    def numbers(self) -> NDArray[np.float64]:
        """Return the samples (repeat, values in each); raise for text and compound types."""
        dtype = _NUMBERS.get(self.type)
        if dtype is None or not self.size or self.size % np.dtype(dtype).itemsize:
            raise ParameterError(
                f"GPMF {self.key} - holds no plain numbers (got type {self.type!r}) - take another key"
            )
        values = np.frombuffer(self.data[: self.size * self.repeat], dtype)
        return values.reshape(self.repeat, self.size // values.itemsize).astype(np.float64)


def parse_gpmf(data: bytes) -> tuple[Record, ...]:
    """Return the records of GPMF payloads, in order; raise `ParameterError` where a record runs past the end."""
    return tuple(_records(data, "GPMF"))


def _records(data: bytes, where: str, depth: int = 0) -> Iterator[Record]:
    if depth > _DEEPEST:
        raise ParameterError(f"GPMF - has records within records (got more than {_DEEPEST}) - copy it again")
    offset = 0
    while offset + 8 <= len(data):
        code, kind, size, repeat = struct.unpack_from(">4scBH", data, offset)
        if code == b"\0\0\0\0":  # padding at the end of a payload; others may follow
            offset += 4
            continue
        key, length = code.decode("latin-1"), size * repeat
        body = data[offset + 8 : offset + 8 + length]
        if len(body) < length:
            raise ParameterError(
                f"{where} - record {key!r} is cut off (got {len(body)} of {length} bytes) - copy it again"
            )
        children = tuple(_records(body, f"{where}/{key}", depth + 1)) if kind == b"\0" else ()
        yield Record(key, kind.decode("latin-1"), size, repeat, b"" if children else body, children)
        offset += 8 + (length + 3) // 4 * 4


def _scaled(record: Record, scale: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the samples of a record divided by its stream's scale; raise `ParameterError` where it does not fit."""
    samples = record.numbers()
    if scale.size not in (1, samples.shape[1]) or not np.all(scale):
        raise ParameterError(f"GPMF {record.key} - its scale does not fit (got {scale.tolist()!r:.40}) - copy it again")
    return samples / scale


def streams(data: bytes, key: str) -> list[NDArray[np.float64]]:
    """Return the scaled samples (n, k) of stream `key`, one array for each payload that has it."""
    found: list[NDArray[np.float64]] = []

    def visit(records: tuple[Record, ...]) -> None:
        scale: NDArray[np.float64] = np.ones(1)
        for record in records:
            if record.key == "SCAL":
                scale = record.numbers().ravel()
            elif record.key == key:
                found.append(_scaled(record, scale))
            visit(record.children)

    visit(parse_gpmf(data))
    return found
