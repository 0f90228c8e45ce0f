# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import ctypes
import functools
import gc
import importlib.metadata
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does: the workers share the cores

import numpy as np
import pytest
from filelock import FileLock

from mr360uw import cli
from mr360uw.base.cache import drop_shared
from mr360uw.base.disk_cache import FOLDER, kernel_folder
from mr360uw.gl import release_unused
from mr360uw.sample import DiveSettings, SampleDive, rendered_dive
from tests.command import command_line
from tests.glsl import gl_available

MadeOnce = Callable[[str, Callable[[Path], SampleDive]], SampleDive]

LONGEST = (
    "tune/test_page.py", "test_pipeline.py", "test_cli.py", "sample/test_sample_dive.py", "render/test_holding.py",
    "composite/test_ambient.py", "runs/test_resuming.py", "render/test_loader.py", "test_docstrings.py",
    "surface/test_picture.py", "test_cache.py", "render/test_gain.py", "first_look/test_looks.py",
    "first_look/test_first_scene.py", "hostile/test_command_line.py",
)  # fmt: skip
"""Files that take longest, in this order."""
_M_ARENA_MAX = -8
_C = ctypes.CDLL(None) if sys.platform == "linux" else None
if "PYTEST_XDIST_WORKER" in os.environ:
    # Each worker has a core to itself: OpenGL in software, which takes all of them, draws with one thread
    os.environ.setdefault("LP_NUM_THREADS", "1")
if hasattr(_C, "mallopt"):
    # The C library keeps what is freed, for each thread its own: a worker would come to hold twice what it uses. At the
    # end of a file it is given back (`_nothing_shared_by_files`); at once, pages would be cleared for every array.
    _C.mallopt(_M_ARENA_MAX, 2)


def pytest_configure(config: pytest.Config) -> None:
    """Have pytest-xdist give out files in the order that follows, not by how many tests they have."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest: no worker is left with one of them when the others have ended."""
    folder = Path(__file__).parent
    place = {folder / name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path, len(LONGEST)))


def pytest_unconfigure() -> None:
    """Have Python collect at its end what `_nothing_shared_by_files` put aside: compiled libraries report the rest."""
    gc.unfreeze()


def _shared_folder(tmp_path_factory: pytest.TempPathFactory, name: str) -> Path:
    """Return a folder that the workers of one run share."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder


@pytest.fixture(scope="session", autouse=True)
def _own_disk_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Results that are kept between runs begin empty, and are not those of the user, whose kernels are used.

    Workers of one run share them: fixtures of equal dives are solved once.
    """
    shared = _shared_folder(tmp_path_factory, "kept")
    with pytest.MonkeyPatch.context() as patch:
        kernels = kernel_folder()
        if kernels is None or not os.access(next(p for p in (kernels, *kernels.parents) if p.exists()), os.W_OK):
            kernels = Path(__file__).resolve().parents[1] / "build" / "kernels"  # of a user without a home
        patch.setenv("NUMBA_CACHE_DIR", str(kernels))
        patch.setenv(FOLDER, str(shared))
        yield


@pytest.fixture(scope="session", autouse=True)
def _versions_read_once() -> Iterator[None]:
    """Versions of packages, which the report of every run states, are read from their files once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(importlib.metadata, "version", functools.cache(importlib.metadata.version))
        yield


@pytest.fixture(scope="session", autouse=True)
def _floors_made_once() -> Iterator[None]:
    """Floors of sample dives, a second each, are made once for the dives whose floors have the same parameters."""
    made, of_floor = rendered_dive.sea_bed, {"seed", "sand_albedo", "sand_contrast", "rocks", "grass", "relief"}

    @functools.lru_cache(maxsize=2)
    def kept(parameters: tuple[tuple[str, float], ...]) -> tuple[np.ndarray, ...]:
        return made(DiveSettings(**dict(parameters)))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            rendered_dive, "sea_bed", lambda settings: kept(tuple(settings.model_dump(include=of_floor).items()))
        )
        yield


@pytest.fixture(scope="module", autouse=True)
def _nothing_shared_by_files() -> Iterator[None]:
    """What scenes of a file share is let go at its end, as a compositor does when it is closed; freed memory too.

    What is alive before it, modules above all, is put aside: each search for garbage would go through it.
    """
    gc.freeze()
    yield
    drop_shared()
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
    from mr360uw.gl import gl_context

    try:
        gl_context()
    except GlError as error:
        pytest.skip(f"no OpenGL here: {error}")


@pytest.fixture(scope="session")
def whale(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whale of the sample dive, small, coarse and rigid."""
    from mr360uw.sample.dive import write_whale

    path = tmp_path_factory.mktemp("whale") / "whale.glb"
    write_whale(path, length_m=2.0, detail="low", swims=False)
    return path


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> MadeOnce:
    """Sample dives by their names: the first worker that needs one makes it, and each gets files of its own."""
    shared = _shared_folder(tmp_path_factory, "made")

    def dive_of(name: str, make: Callable[[Path], SampleDive]) -> SampleDive:
        with FileLock(shared / f"{name}.lock"):
            if not (shared / name).exists():
                make(shared / f"{name} unfinished")
                (shared / f"{name} unfinished").rename(shared / name)
        folder = shutil.copytree(shared / name, tmp_path_factory.mktemp("dives") / name)
        return SampleDive(folder / "dive.mp4", folder / "whale.glb", folder / "scene.toml", folder / "truth.json")

    return dive_of


@pytest.fixture(scope="session")
def dive(made_once: MadeOnce) -> SampleDive:
    """A sample dive of eight frames, 256x128, with ripples that spread the sun over a pixel and more.

    Its scene draws coarsely, in a quarter of the time.
    """
    from mr360uw.sample import sample_dive

    settings = DiveSettings(detail_slope=0.05)
    made = made_once("dive", lambda folder: sample_dive(folder, settings, width=256, frames=8))
    text = made.scene.read_text("utf-8")
    coarse = {
        "ambient_occlusion": "false",
        "samples": 5,
        "sun_samples": 2,
        "size": 64,
        "grid": 32,
        "planes": 2,
        "bands": 8,
        "rough": "true",
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
        monkeypatch.setattr(cli, "app", command_line())
        monkeypatch.setattr(sys, "argv", ["mr360uw", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as done:
            code = int(done.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call
