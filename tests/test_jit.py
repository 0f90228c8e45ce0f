# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels are used again exactly where all that their machine code follows from is the same."""

from __future__ import annotations

import errno
import hashlib
import importlib
import importlib.util
import os
import pickle
import pkgutil
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import mr360uw
from mr360uw.jit import ahead, exact, fast, mix_texels

HELPER = "from mr360uw.jit import inlined\nFACTOR = {}\n@inlined\ndef part(x):\n    return x * FACTOR\n"
LOOP = "from mr360uw.jit import {}\n@{}\ndef whole(x):\n    return part(x) + 1.0\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Sources of a kernel and of a part of it in another file; kernels are kept beside them."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    (tmp_path / "helper.py").write_text(HELPER.format(2.0))
    (tmp_path / "loop.py").write_text(LOOP.format("exact", "exact"))
    return tmp_path


def run(folder: Path, **names: object) -> tuple[float, int]:
    """Load the kernel as a new process does; return its value at 3, and how often it was compiled."""
    made: dict[str, ModuleType] = {}
    for name in ("helper", "loop"):
        spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
        assert spec is not None
        made[name] = importlib.util.module_from_spec(spec)
        vars(made[name]).update(vars(made["helper"]) if name == "loop" else {}, **names)
        exec(compile((folder / f"{name}.py").read_text(), name, "exec"), vars(made[name]))
    whole = made["loop"].whole
    return whole(3.0), sum(whole.stats.cache_misses.values())


def test_an_edit_of_an_inlined_part_compiles_anew_and_nothing_else_does(folder: Path) -> None:
    assert run(folder) == (7.0, 1)
    assert run(folder) == (7.0, 0)
    (folder / "helper.py").write_text("# a comment, and more\n\n" + HELPER.format(2.0) + "OTHER = 3\n")
    os.utime(folder / "loop.py", (1, 1))
    assert run(folder) == (7.0, 0), "times, comments and what the kernel does not name change no machine code"
    (folder / "helper.py").write_text(HELPER.format(5.0))
    assert run(folder) == (16.0, 1), "a constant of another file"
    (folder / "helper.py").write_text(HELPER.format(5.0).replace("x * FACTOR", "x + FACTOR"))
    assert run(folder) == (9.0, 1), "arithmetic of another file"
    (folder / "loop.py").write_text(LOOP.format("fast", "fast"))
    assert run(folder) == (9.0, 1), "the same arithmetic, in another order"


def test_arrays_that_a_kernel_names_count_by_what_is_in_them(folder: Path) -> None:
    (folder / "helper.py").write_text(HELPER.format("np.arange(3.0)").replace("x * FACTOR", "x * FACTOR[2]"))
    assert run(folder, np=np) == (7.0, 1)
    (folder / "helper.py").write_text((folder / "helper.py").read_text().replace("3.0)", "3.0) + 1.0"))
    assert run(folder, np=np) == (10.0, 1)


def test_kernels_travel(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies of the same sources share them, and those that came with the package are found first."""
    assert run(folder) == (7.0, 1)
    copy = shutil.copytree(folder, folder / "copy", ignore=shutil.ignore_patterns("kept"))
    assert run(copy) == (7.0, 0)
    shipped = (folder / "kept").rename(folder / "shipped")
    monkeypatch.setattr("mr360uw.jit.SHIPPED", shipped)

    def read_only(*_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("mr360uw.base.disk_cache.os.utime", read_only)
    assert run(copy) == (7.0, 0)
    assert not (folder / "kept").exists()


def test_a_kernel_whose_part_moved_to_another_module_is_compiled_anew(folder: Path) -> None:
    """A kept kernel names the modules of its parts, by which they are looked up when it is loaded."""
    part, source = "from mr360uw.jit import exact\n@exact\ndef part(x):\n    return 2.0 * x\n", folder / "part.py"
    source.write_text(part)
    loop = folder / "moved.py"
    for _ in range(2):
        loop.write_text(LOOP.format("exact", "exact") + f"from {source.stem} import part\nprint(whole(3.0))\n")
        done = subprocess.run([sys.executable, "moved.py"], cwd=folder, capture_output=True, text=True)
        assert done.stdout == "7.0\n", done.stderr
        source = source.rename(folder / "elsewhere.py")


def test_a_damaged_kernel_is_compiled_anew(folder: Path) -> None:
    assert run(folder) == (7.0, 1)
    for kept in (folder / "kept").iterdir():
        kept.write_bytes(kept.read_bytes()[:-40])
    assert run(folder) == (7.0, 1)
    assert run(folder) == (7.0, 0)


class Attack:
    """A pickle that makes a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.mark,)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have owners on POSIX")
@pytest.mark.parametrize("way", ["file", "open file", "folder", "open folder", "open above"])
def test_a_planted_kernel_is_not_loaded(way: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of another user, or where others could have put it; it is compiled anew."""
    above = folder / "above"
    above.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(above / "kept"))
    assert run(folder) == (7.0, 1)
    (kept,) = (above / "kept").glob("*whole-*.nbc")
    planted = pickle.dumps(Attack(folder / "mark"))
    kept.write_bytes(planted + hashlib.sha256(planted).digest())
    target = {"above": above, "folder": above / "kept", "file": kept}[way.split()[-1]]
    if way.startswith("open"):
        target.chmod(0o777)
    elif os.geteuid() == 0:
        os.chown(target, 54321, 54321)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 54321)
    assert run(folder) == (7.0, 1)
    assert not (folder / "mark").exists()


@pytest.mark.parametrize("kind", [exact, fast])
def test_a_kernel_that_counts_no_users_returns_no_array(
    kind: Callable[[Any], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The caller would free what it was passed
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with pytest.raises(TypeError, match="returns an array"):
        kind(lambda x: x)(np.zeros(3))


def test_a_kernel_that_counts_no_users_calls_none_that_makes_arrays() -> None:
    # What it is returned would never be freed
    asked, wrong = 0, []
    for found in pkgutil.walk_packages(mr360uw.__path__, "mr360uw."):
        for name, kernel in vars(importlib.import_module(found.name)).items():
            if isinstance(kernel, Dispatcher) and not kernel.targetoptions.get("_nrt", True):
                named = kernel.py_func.__globals__
                called = [named.get(part) for part in kernel.py_func.__code__.co_names]
                counting = [part for part in called if isinstance(part, Dispatcher) and makes_arrays(part)]
                wrong += [f"{found.name}.{name}"] if counting else []
                asked += 1
    assert asked > 50
    assert not wrong


@exact
def mixed(texels: Any, shares: Any, out: Any) -> None:
    """Mix texels 1 and 2 of each of two rows of four into the second place of `out`."""
    four = shares[0], shares[1], shares[2], shares[3]
    mix_texels(texels, (np.uint64(4), np.uint64(20)), four, out, np.uint64(4))


def test_texels_are_mixed_in_their_shares() -> None:
    draw = np.random.default_rng(7)
    texels, shares = draw.random((2, 4, 4), np.float32), draw.random(4, np.float32)
    out = np.zeros(12, np.float32)
    mixed(texels.reshape(-1), shares, out)
    found = shares @ texels[:, 1:3].reshape(4, 4)
    np.testing.assert_allclose(out, [0, 0, 0, 0, *found, 0, 0, 0, 0], rtol=4e-7)  # three roundings of single floats


def makes_arrays(kernel: Dispatcher) -> bool:
    """Return whether a kernel counts who uses arrays, and is not compiled as part of its caller."""
    return bool(kernel.targetoptions.get("_nrt", True) and kernel.targetoptions.get("inline") != "always")


def test_kernels_listed_for_a_plain_composite_are_there() -> None:
    """Each line of the list is what its kernel and its arguments are written as."""
    lines = ahead.LIST.read_text("utf-8").splitlines()
    assert len(lines) > 30
    for line in lines:
        assert ahead.entry(*ahead._read(line)) == line


def test_kernels_are_compiled_ahead_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By processes of their own, which are counted; a second run finds them."""
    quick = [line for line in ahead.LIST.read_text("utf-8").splitlines() if "device write_lanes" in line]
    assert quick
    (tmp_path / "kernels.txt").write_text("\n".join(quick))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    monkeypatch.setattr(ahead, "LIST", tmp_path / "kernels.txt")
    monkeypatch.setattr("mr360uw.jit.SHIPPED", tmp_path / "none")
    told: list[tuple[int, int | None]] = []
    ahead.compile_ahead(lambda done, total: told.append((done, total)))
    assert told == [(1, 1)]
    assert ahead.size(*ahead._read(quick[0])) > 0
    ahead.compile_ahead(lambda done, total: told.append((done, total)))
    assert told == [(1, 1)]


def test_nothing_is_compiled_ahead_where_it_cannot_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "a file"))
    monkeypatch.setattr("mr360uw.jit.SHIPPED", tmp_path / "none")
    quick = [line for line in ahead.LIST.read_text("utf-8").splitlines() if "device write_lanes" in line]
    (tmp_path / "kernels.txt").write_text("\n".join(quick))
    monkeypatch.setattr(ahead, "LIST", tmp_path / "kernels.txt")
    told: list[tuple[int, int | None]] = []
    ahead.compile_ahead(lambda done, total: told.append((done, total)))
    assert told == []


def test_a_run_with_nowhere_to_keep_kernels_compiles_them_as_it_goes(tmp_path: Path) -> None:
    code = "from mr360uw.jit.ahead import compile_ahead; compile_ahead(print)"
    named = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", code], env={**named, "MR360UW_CACHE": ""}, cwd=tmp_path, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert done.stdout == ""


def test_a_kept_kernel_is_loaded_without_what_the_compiler_needs(tmp_path: Path) -> None:
    """The compiler's own functions of NumPy and SciPy take a quarter of a second to load."""
    (tmp_path / "twice.py").write_text(
        "import sys\nfrom mr360uw.jit import exact\n@exact\ndef twice(x):\n    return 2.0 * x\n"
        "print(twice(1.5), 'numba.np.linalg' in sys.modules)\n"
    )
    kept = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    command = [sys.executable, "-c", "import twice"]
    said = [subprocess.check_output(command, cwd=tmp_path, env=kept, text=True).split() for _ in range(2)]
    assert said == [["3.0", "True"], ["3.0", "False"]]


def test_a_kept_kernel_becomes_part_of_one_that_is_compiled(tmp_path: Path) -> None:
    """Also where it was called before: its bitcode is read when another kernel needs it."""
    (tmp_path / "twice.py").write_text(
        "import sys\nfrom mr360uw.jit import exact\n@exact\ndef twice(x):\n    return 2.0 * x\n"
        "@exact\ndef four_times(x):\n    return twice(twice(x))\n"
        "print(twice(1.5), four_times(1.5) if len(sys.argv) > 1 else '')\n"
    )
    kept = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    for more, said in ([], ["3.0"]), (["more"], ["3.0", "6.0"]), (["more"], ["3.0", "6.0"]):
        command = [sys.executable, "-c", "import twice", *more]
        assert subprocess.check_output(command, cwd=tmp_path, env=kept, text=True).split() == said
