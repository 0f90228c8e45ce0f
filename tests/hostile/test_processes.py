# SPDX-License-Identifier: Apache-2.0
"""Closed streams, signals and limits of memory, which need a process of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import mr360uw
from tests.hostile.bench import Bench, contents
from tests.hostile.test_meshes import glb
from tests.hostile.test_pictures import announced, png_of

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")

MEMORY_BYTES = 2_000_000_000
"""Largest memory that refusing bad input may take."""
REFUSING = """
import pathlib, re, sys
from mr360uw import cli
for setting in sys.argv[1:]:
    sys.argv = ["mr360uw", "composite", "scene.toml", "out.png", "--set", setting]
    try:
        cli.main()
    except SystemExit as done:
        peak = re.search(r"VmHWM:\\s+(\\d+) kB", pathlib.Path("/proc/self/status").read_text())
        print(done.code, 1024 * int(peak[1]))
"""
ENVIRONMENT = os.environ | {
    "PYTHONPATH": str(Path(mr360uw.__file__).parents[1]),
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"),
}  # fmt: skip
PROGRAM = [sys.executable, "-m", "mr360uw"]
WAITING = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # as in a terminal; a shell's background jobs ignore it
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
sys.argv = ["mr360uw", "composite", "scene.toml", "out.png"]
from mr360uw.__main__ import main
main()
"""


@pytest.mark.parametrize("closing", ["2>&-", "<&- >&- 2>&-"])
def test_closed_streams(closing: str, bench: Bench) -> None:
    before = contents(bench.folder)
    command = f'exec "{sys.executable}" -m mr360uw sample dive --width 1 {closing}'
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, env=ENVIRONMENT)
    assert done.returncode == 2
    assert done.stdout == done.stderr == ""
    assert contents(bench.folder) == before


@pytest.mark.parametrize("closing", ["2>&-", ">&-", "<&- >&- 2>&-"])
def test_an_output_does_not_take_the_number_of_a_closed_stream(closing: str, bench: Bench) -> None:
    code = (
        "import os, pathlib, mr360uw.__main__ as program;"
        "program._open_standard_streams();"
        "pathlib.Path('number').write_text(str(os.open('output', os.O_CREAT)))"
    )
    assert (
        subprocess.run(["sh", "-c", f"exec '{sys.executable}' -c \"{code}\" {closing}"], env=ENVIRONMENT).returncode
        == 0
    )
    assert int((bench.folder / "number").read_text()) > 2


def test_a_full_disk_behind_the_output_is_told() -> None:
    command = f'exec "{sys.executable}" -m mr360uw schema >/dev/full'
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, env=ENVIRONMENT)
    assert done.returncode == 2
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("name", ["typer", "mr360uw.cli", "mr360uw.runs.pipeline"])
def test_an_interrupt_while_modules_load(name: str, bench: Bench) -> None:
    before = contents(bench.folder)
    done = subprocess.run(
        [sys.executable, "-c", WAITING.format(name=name)], capture_output=True, text=True, env=ENVIRONMENT
    )
    assert done.returncode == 128 + signal.SIGINT
    assert "Traceback" not in done.stderr
    assert contents(bench.folder) == before


def bombs(bench: Bench) -> dict[str, tuple[bytes, str]]:
    """Return files that announce or unpack to far more than they hold, and the setting that reads each."""
    files = bench.material.files
    return {
        "plate.exr": (announced(files["plate.exr"], ".exr", 40_000, 20_000), 'plate.path="{}"'),
        "bomb.png": (png_of(16_384, 16_384), 'object.0.texture="{}"'),
        "many.glb": (glb(b'{"a":[' + b"[]," * 8_000_000 + b"1]}"), 'object.0.mesh="{}"'),
        "many.ply": (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 400000000\nproperty float x\nproperty float y\n"
            b"property float z\nelement face 4000000\nproperty list uchar int vertex_indices\nend_header\n" + bytes(9),
            'object.0.mesh="{}"',
        ),
    }  # fmt: skip


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the largest memory of a process from /proc")
def test_memory_of_what_is_refused(bench: Bench) -> None:
    found = bombs(bench)
    for name, (data, _) in found.items():
        bench.put(name, data)
    before = contents(bench.folder)
    settings = [setting.format(name) for name, (_, setting) in found.items()]
    done = subprocess.run(
        [sys.executable, "-c", REFUSING, *settings], capture_output=True, text=True, env=ENVIRONMENT, timeout=60
    )
    told = [line.split() for line in done.stdout.splitlines()]
    assert [code for code, _ in told] == ["2"] * len(found), done.stderr
    assert int(told[-1][1]) < MEMORY_BYTES
    assert all(name in done.stderr for name in found)
    assert "Traceback" not in done.stderr
    assert contents(bench.folder) == before


def test_too_little_memory_is_told(bench: Bench) -> None:
    """A picture within the limits, in a process that may not have the memory for it."""
    bench.put("wide.png", png_whole(12_000, 6_000))
    command = [
        *PROGRAM,
        "composite",
        "scene.toml",
        "out.png",
        "--set",
        'plate.path="wide.png"',
        "--backend",
        "reference",
    ]

    def limit() -> None:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (1_200_000_000, 1_200_000_000))

    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, preexec_fn=limit)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert not (bench.folder / "out.png").exists()


def png_whole(width: int, height: int) -> bytes:
    """Return a PNG of zeros."""
    import struct
    import zlib

    from tests.hostile.test_pictures import chunk

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    packer = zlib.compressobj(1)
    rows = b"".join(packer.compress(bytes(1 + 3 * width)) for _ in range(height)) + packer.flush()
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
