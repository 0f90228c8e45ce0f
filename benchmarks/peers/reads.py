# SPDX-License-Identifier: Apache-2.0
"""The layered EXR as other programs read it: names, types, windows and values.

    python benchmarks/peers/reads.py [--file layers_0000.exr] [--blender PROGRAM]

Readers: OpenImageIO (`pip install OpenImageIO`), the library by which many programs read pictures, and Blender 5
(`--blender`: blender itself, or a Python that has bpy). Each is compared with the same file read by OpenEXR, the
format's own library. A reader that is not there is named, and the others are run. Exit code 1 where one reads
otherwise.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from mr360uw.composite.aovs import RECIPE, cryptomatte, exr_parts, motion  # noqa: E402
from mr360uw.composite.reference import render_aovs  # noqa: E402
from mr360uw.composite.shot import Receiver  # noqa: E402
from mr360uw.video import write_exr  # noqa: E402
from tests.composite.scenes import medium, placed, plate, shot, sphere  # noqa: E402

WIDTH = 64
APART = 1e-6
"""Largest difference of a value, of itself where it is above 1: all readers hold half and single floats exactly."""
_SECONDS = 300
_TYPES = {np.dtype(np.float16): "half", np.dtype(np.float32): "float", np.dtype(np.uint32): "uint"}

Window = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A part of a file. channels: arrays (H, W) by name; kind: "half", "float", "uint", or "" where a reader does not
    say; window: of the data (column, row, width, height), or None where it does not say.
    """

    channels: dict[str, np.ndarray]
    kind: str
    window: Window | None


class MissingError(Exception):
    """A reader that is not installed; the message says how to install it."""


def by_openexr(path: Path) -> tuple[str, dict[str, Layer]]:
    """Return the version and the layers by the format's own library."""
    import OpenEXR

    found = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            low, high = part.header["dataWindow"]
            arrays = {name: channel.pixels for name, channel in part.channels.items()}
            column, row = int(low[0]), int(low[1])
            window = (column, row, int(high[0]) - column + 1, int(high[1]) - row + 1)
            found[part.name()] = Layer(arrays, _TYPES[next(iter(arrays.values())).dtype], window)
    return "OpenEXR", found


def by_openimageio(path: Path) -> tuple[str, dict[str, Layer]]:
    """Return the version and the layers as OpenImageIO reads them."""
    if importlib.util.find_spec("OpenImageIO") is None:
        raise MissingError("pip install OpenImageIO")
    oiio: Any = importlib.import_module("OpenImageIO")
    found = {}
    for number in range(oiio.ImageBuf(str(path)).nsubimages):
        buffer = oiio.ImageBuf(str(path), number, 0)
        spec = buffer.spec()
        pixels = buffer.get_pixels(oiio.UINT32 if str(spec.format) == "uint" else oiio.FLOAT)
        arrays = {name: pixels[..., k] for k, name in enumerate(spec.channelnames)}
        found[spec["name"]] = Layer(arrays, str(spec.format), (spec.x, spec.y, spec.width, spec.height))
    return f"OpenImageIO {oiio.__version__}", found


def by_blender(path: Path, program: str) -> tuple[str, dict[str, Layer]]:
    """Return the version and the layers as Blender's compositor reads them; it does not say types and windows."""
    if not program or shutil.which(program) is None:
        raise MissingError("--blender PROGRAM: blender 5, or a Python with `pip install bpy`")
    script = str(Path(__file__).with_name("blender_reads.py"))
    own = "blender" in Path(program).name
    start = [program, "-b", "--factory-startup", "--python", script] if own else [program, script]
    _, _, width, height = next(iter(by_openexr(path)[1].values())).window or (0, 0, 0, 0)
    with tempfile.TemporaryDirectory() as folder:
        command = [*start, "--", str(path), f"{folder}/", str(width), str(height)]
        said = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS, check=True).stdout
        version, sockets = json.loads(next(line for line in said.splitlines() if line.startswith("READ "))[5:])
        written = by_openexr(Path(folder) / "read.exr")[1]
    found = {}
    for name, kind in sockets.items():
        given = {channel.removeprefix(f"{name}."): array for channel, array in written[name].channels.items()}
        found[name] = Layer(given | ({"value": given["V"]} if kind == "VALUE" else {}), "", None)
    return f"Blender {version}", found


def differences(expected: dict[str, Layer], found: dict[str, Layer]) -> list[tuple[str, str]]:
    """Return (layer, "" or what is read otherwise) for every layer of the file."""
    rows = [(name, "not in the file") for name in found.keys() - expected.keys()]
    for name, layer in expected.items():
        rows.append((name, _difference(name, layer, found[name]) if name in found else "not listed"))
    return rows


def _difference(name: str, layer: Layer, found: Layer) -> str:
    if found.kind and found.kind != layer.kind:
        return f"type {found.kind} for {layer.kind}"
    if found.window is not None and found.window != layer.window:
        return f"window {found.window} for {layer.window}"
    for channel, array in layer.channels.items():
        short = channel.removeprefix(f"{name}.")
        read = found.channels.get(channel, found.channels.get(short))
        if read is None and len(layer.channels) == 1:
            read = found.channels.get("value")
        if read is None:
            return f"no channel {channel} (got {', '.join(found.channels)})"
        wanted = array.astype(np.float64)
        apart = float(np.max(np.abs(read - wanted) / np.maximum(np.abs(wanted), 1.0)))
        if not apart <= APART:
            return f"{channel} is off by {apart:.2g}"
    return ""


def example(folder: Path) -> Path:
    """Return a file of layers: a ball over a floor, in water."""
    body = placed(sphere(), (0.1, -0.5, -1.2))
    scene = shot(body, width=WIDTH, medium=medium(), receiver=Receiver(plane_y=-1.2))
    layer, variables = render_aovs(scene)
    moved = [motion(variables, scene, [placed(sphere(), (x, -0.5, -1.2))], scene.view) for x in (0.2, 0.0)]
    mattes, header = cryptomatte(variables, scene, ["ball"])
    path = folder / "layers_0000.exr"
    parts = exr_parts(layer, variables, plate(WIDTH), (moved[0], moved[1])) | mattes
    write_exr(path, parts, attributes={"comments": RECIPE} | header)
    return path


def main() -> int:
    """Print a line for every reader and for every layer that it reads otherwise; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--file", type=Path, help="of --layers; default: one that is made")
    parser.add_argument("--blender", default="blender", help="blender 5, or a Python that has bpy")
    given = parser.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        path = given.file or example(Path(folder))
        _, expected = by_openexr(path)
        channels = sum(len(layer.channels) for layer in expected.values())
        print(
            f"{path.name}: {len(expected)} layers, {channels} channels, window {next(iter(expected.values())).window}"
        )
        readers: dict[str, Callable[[], tuple[str, dict[str, Layer]]]] = {
            "OpenImageIO": lambda: by_openimageio(path),
            "Blender": lambda: by_blender(path, given.blender),
        }
        for name, read in readers.items():
            try:
                version, found = read()
            except MissingError as error:
                print(f"{name:22} is not here - {error}")
                continue
            rows = differences(expected, found)
            odd = [row for row in rows if row[1]]
            wrong += len(odd)
            says = "names, types, windows, values" if next(iter(found.values())).kind else "names, values"
            print(f"{version:22} {len(rows) - len(odd)} of {len(expected)} layers the same ({says} within {APART:g})")
            for layer, what in odd:
                print(f"    {layer:20} {what}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
