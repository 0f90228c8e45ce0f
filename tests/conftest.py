# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import ctypes
import gc
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does: the workers share the cores

import numpy as np
import pytest

from mr360uw import cli
from mr360uw.cache import drop_shared
from mr360uw.gl.context import release_unused
from mr360uw.reading.disk_cache import FOLDER, kernel_folder
from tests.glsl import gl_available

_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8
_C = ctypes.CDLL(None) if sys.platform == "linux" else None
if hasattr(_C, "mallopt"):
    # Arrays go back to the system when they are freed. The C library would keep them, for each thread its own, and a
    # worker would come to hold twice what it uses.
    _C.mallopt(_M_MMAP_THRESHOLD, 1 << 20)
    _C.mallopt(_M_ARENA_MAX, 2)


@pytest.fixture(scope="session", autouse=True)
def _own_disk_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Results that are kept between runs begin empty, and are not those of the user, whose kernels are used.

    Workers of one run share them: fixtures of equal dives are solved once.
    """
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "kept"
    shared.mkdir(mode=0o700, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        kernels = kernel_folder()
        if kernels is None or not os.access(next(p for p in (kernels, *kernels.parents) if p.exists()), os.W_OK):
            kernels = Path(__file__).resolve().parents[1] / "build" / "kernels"  # of a user without a home
        patch.setenv("NUMBA_CACHE_DIR", str(kernels))
        patch.setenv(FOLDER, str(shared))
        yield


@pytest.fixture(scope="module", autouse=True)
def _nothing_shared_by_files() -> Iterator[None]:
    """What scenes of a file share is let go at its end, as a compositor does when it is closed; freed memory too."""
    yield
    drop_shared()
    gc.unfreeze()  # what `mr360uw tune` put aside in this process is collected again, and counted by tests
    gc.collect()
    if gl_available():
        release_unused()
    if hasattr(_C, "malloc_trim"):
        _C.malloc_trim(0)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(360)


@pytest.fixture(scope="session")
def gl() -> None:
    """Skip where OpenGL 3.3 cannot be had."""
    from mr360uw.errors import GlError
    from mr360uw.gl.context import gl_context

    try:
        gl_context()
    except GlError as error:
        pytest.skip(f"no OpenGL here: {error}")


@pytest.fixture(scope="session")
def whale(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whale of the sample dive, small, coarse and rigid."""
    from mr360uw.sample.whale import write_whale

    path = tmp_path_factory.mktemp("whale") / "whale.glb"
    write_whale(path, length_m=2.0, detail="low", swims=False)
    return path


@pytest.fixture(scope="session")
def dive(tmp_path_factory: pytest.TempPathFactory):
    """A sample dive of eight frames, 256x128, with ripples that spread the sun over a pixel and more.

    Its scene draws coarsely, in a quarter of the time.
    """
    from mr360uw.sample import DiveSettings, sample_dive

    made = sample_dive(tmp_path_factory.mktemp("dive"), DiveSettings(detail_slope=0.05), width=256, frames=8)
    text = made.scene.read_text("utf-8")
    coarse = {
        "ambient_occlusion": "false",
        "samples": 5,
        "sun_samples": 2,
        "size": 64,
        "grid": 32,
        "planes": 2,
        "bands": 8,
    }
    for key, value in coarse.items():
        text = re.sub(rf"^# {key} = [^ ]+", f"{key} = {value}", text, count=1, flags=re.MULTILINE)
    made.scene.write_text(text, "utf-8")
    return made


@pytest.fixture(params=["reference", "gl"])
def backend(request: pytest.FixtureRequest) -> str:
    """Each renderer in turn; gl skips where there is no OpenGL."""
    if request.param == "gl":
        request.getfixturevalue("gl")
    return str(request.param)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, str, str]]:
    """Run the command line in this process; return exit code, output and errors."""

    def call(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["mr360uw", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as done:
            code = int(done.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call
