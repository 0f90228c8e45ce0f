# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers: camera tracks, sun tracks, waters, sensors, gravity of a camera."""

from __future__ import annotations

import json
import struct

import pytest

from mr360uw.errors import Mr360uwError
from mr360uw.ibl import load_track
from mr360uw.medium import Sensor, Water
from tests.hostile.bench import Bench

TEXTS = {
    "empty": b"", "a line": b"\n", "zeros": bytes(500), "binary": bytes(range(256)) * 4, "page": b"<html>\n" * 9,
    "words": b"time_s,x,y,z,qx,qy,qz,qw\na,b,c,d,e,f,g,h\n", "header": b"time_s,x,y,z,qx,qy,qz,qw\n",
    "long cell": b"wavelength_nm,absorption,scattering\n" + b"9" * 200_000 + b",1,1\n", "quote": b'a,b\n"1,2\n',
    "ragged": b"wavelength_nm,absorption,scattering\n400,1\n500,1,1,1\n",
}  # fmt: skip
TRACKS = {
    "back in time": b"time_s,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,1\n0,0,0,0,0,0,0,1\n",
    "at one time": b"time_s,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n",
    "no turn": b"time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0\n",
    "half turn": b"time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0.5\n",
    "nan": b"time_s,x,y,z,qx,qy,qz,qw\nnan,0,0,0,0,0,0,1\n",
    "infinite": b"time_s,x,y,z,qx,qy,qz,qw\n0,inf,0,0,0,0,0,1\n",
    "a column less": b"time_s,x,y,z,qx,qy,qz\n0,0,0,0,0,0,0\n",
}
WATERS = {
    "back": b"wavelength_nm,absorption,scattering\n700,1,1\n400,1,1\n",
    "metres": b"wavelength_nm,absorption,scattering\n4e-7,1,1\n7e-7,1,1\n",
    "below zero": b"wavelength_nm,absorption,scattering\n400,-1,1\n700,1,1\n",
    "nan": b"wavelength_nm,absorption,scattering\n400,nan,1\n700,1,1\n",
    "infinite": b"wavelength_nm,absorption,scattering\n400,inf,1\n700,1,1\n",
    "no columns": b"wavelength_nm,depth\n400,1\n700,1\n",
}


def test_camera_tracks(bench: Bench, subtests: pytest.Subtests) -> None:
    for name, data in (TEXTS | TRACKS).items():
        with subtests.test(name):
            bench.put("track.csv", data)
            bench.refuses_with('camera.track="track.csv"', says=("track.csv",))


def test_waters_and_sensors(bench: Bench, subtests: pytest.Subtests) -> None:
    for name, data in (TEXTS | WATERS).items():
        with subtests.test(name):
            path = bench.put("table.csv", data)
            bench.refuses_with('water={type="csv", csv="table.csv"}', says=("table.csv",))
            for read in (Water.from_csv, Sensor.from_csv):
                with pytest.raises(Mr360uwError, match=r"table\.csv"):
                    read(path)


COLUMNS = json.dumps({"columns": {"frame": [0]}})
SUN_TRACKS = {
    "list.json": b"[]", "number.json": b"7", "null.json": b'{"columns": null}', "text.json": b'{"columns": "all"}',
    "few.json": COLUMNS.encode(), "cut.json": b'{"columns": {', "deep.json": b"[" * 100_000, "digits.json": b"9" * 5000,
}  # fmt: skip


def test_sun_tracks(bench: Bench, subtests: pytest.Subtests) -> None:
    for name in [*SUN_TRACKS, *(f"{name}.csv" for name in TEXTS), *(f"{name}.json" for name in TEXTS)]:
        with subtests.test(name):
            path = bench.put(name, SUN_TRACKS.get(name) or TEXTS[name.partition(".")[0]])
            with pytest.raises(Mr360uwError, match=name):
                load_track(path)


GRAVITY = {
    "empty": b"", "text": b"no metadata" * 20, "cut": struct.pack(">4scBH", b"GRAV", b"s", 6, 1000) + bytes(9),
    "text for numbers": struct.pack(">4scBH", b"GRAV", b"c", 1, 4) + b"down",
    "no numbers": struct.pack(">4scBH", b"GRAV", b"s", 6, 0),
    "of no size": struct.pack(">4scBH", b"GRAV", b"s", 0, 4),
    "of two": struct.pack(">4scBH", b"GRAV", b"s", 4, 1) + bytes(4),
    "of zeros": struct.pack(">4scBH", b"GRAV", b"s", 6, 2) + bytes(12),
    "of nan": struct.pack(">4scBH", b"GRAV", b"f", 12, 1) + b"\xff" * 12,
    "scaled by zero": struct.pack(">4scBH", b"SCAL", b"s", 2, 1) + bytes(4)
                      + struct.pack(">4scBH", b"GRAV", b"s", 6, 1) + b"\0\1" * 3 + bytes(2),
    "scaled by three": struct.pack(">4scBH", b"SCAL", b"s", 2, 2) + b"\0\1" * 2
                       + struct.pack(">4scBH", b"GRAV", b"s", 6, 1) + b"\0\1" * 3 + bytes(2),
    "within itself": b"".join(struct.pack(">4scBH", b"STRM", b"\0", 1, 8 * (7999 - k)) for k in range(8000)),
}  # fmt: skip


def test_gravity(bench: Bench, subtests: pytest.Subtests) -> None:
    for name, data in GRAVITY.items():
        with subtests.test(name):
            bench.put("camera.bin", data)
            bench.refuses_with('camera.gravity="camera.bin"', says=("camera.bin",))
