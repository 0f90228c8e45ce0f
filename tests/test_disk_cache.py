# SPDX-License-Identifier: Apache-2.0
"""Results that are kept on the disk between runs."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from mr360uw.base import disk_cache
from mr360uw.base.disk_cache import (
    FOLDER,
    Arrays,
    cache_file,
    cache_folder,
    cache_notes,
    keep_arrays,
    kept_arrays,
    kernel_folder,
    read_arrays,
)
from mr360uw.composite.ambient.mesh_transfer import make_transfer
from mr360uw.composite.mesh.mesh import Mesh, load_mesh
from mr360uw.medium import Medium, Water
from mr360uw.medium.scattered_light import spread_of

COLUMNS = np.asfortranarray(np.arange(12.0).reshape(3, 4))


@pytest.fixture(autouse=True)
def _empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path / "kept"))


class Made:
    """Makes arrays and counts how often."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> Arrays:
        self.count += 1
        return {"columns": COLUMNS, "number": np.array(0.1)}


def test_results_are_made_once_and_are_the_same_from_the_disk() -> None:
    make = Made()
    made, read = (kept_arrays("test", (COLUMNS, "a", 1.5), make) for _ in range(2))
    assert make.count == 1
    for name, array in made.items():
        np.testing.assert_array_equal(read[name], array)
        # sums over another order of memory differ in the last bits
        assert (read[name].dtype, read[name].strides) == (array.dtype, array.strides)


@pytest.mark.parametrize("other", [(COLUMNS + 1e-12, "a"), (COLUMNS, "b"), (COLUMNS.astype(np.float32), "a"), (1, "a")])
def test_other_inputs_have_other_results(other: tuple[object, ...]) -> None:
    make = Made()
    for inputs in ((COLUMNS, "a"), other, (COLUMNS, "a")):
        kept_arrays("test", inputs, make)
    assert make.count == 2


def test_after_an_edit_of_the_sources_results_are_made_anew(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    make = Made()
    (tmp_path / "module.py").write_text("a = 1\n")
    monkeypatch.setattr(disk_cache, "_PACKAGE", tmp_path)
    for time_ns in (1, 1, 2):
        os.utime(tmp_path / "module.py", ns=(time_ns, time_ns))
        disk_cache.sources_stamp.cache_clear()
        kept_arrays("test", (), make)
    disk_cache.sources_stamp.cache_clear()
    assert make.count == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"not what was written", None])
def test_a_damaged_file_is_made_anew(damage: bytes | None) -> None:
    make = Made()
    kept_arrays("test", (), make)
    path = cache_file("test", ())
    assert path is not None
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
    kept_arrays("test", (), make)
    assert make.count == 2
    assert path.read_bytes() == whole


def test_a_file_with_a_damaged_byte_is_known() -> None:
    path = cache_file("test", ())
    assert path is not None
    keep_arrays(path, {"a": np.arange(3.0), "b": np.array(["x"])})
    whole = path.read_bytes()
    assert read_arrays(path) is not None
    for k in range(0, len(whole), 16):
        path.write_bytes(whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :])
        assert read_arrays(path) is None


@pytest.mark.parametrize("where", ["", "a file"])
def test_without_a_folder_results_are_made_each_time(
    where: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "a file").touch()
    monkeypatch.setenv(FOLDER, where and str(tmp_path / where))
    make = Made()
    for _ in range(2):
        np.testing.assert_array_equal(kept_arrays("test", (), make)["columns"], COLUMNS)
    assert make.count == 2


def test_a_user_without_a_home_keeps_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv(FOLDER, "~/kept")
    assert cache_folder() == tmp_path / "kept"

    def no_home(_: Path) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "expanduser", no_home)
    monkeypatch.delenv(FOLDER)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert cache_folder() is None


def test_results_used_longest_ago_make_room(monkeypatch: pytest.MonkeyPatch) -> None:
    make = Made()
    paths = [cache_file("test", (number,)) for number in range(3)]
    for number, path in enumerate(paths):
        kept_arrays("test", (number,), make)
        assert path is not None
        os.utime(path, ns=(number, number))
    kept_arrays("test", (0,), make)  # now the last used
    assert make.count == 3
    assert paths[0] is not None
    monkeypatch.setattr(disk_cache, "_ROOM", 3 * paths[0].stat().st_size)
    numbers = [1, 2, 0]
    for number in range(3, 200):  # room is made now and then
        kept_arrays("test", (number,), make)
        numbers.append(number)
        there = [path is not None and path.exists() for path in (cache_file("test", (k,)) for k in numbers)]
        if not all(there):
            break
    assert there == [False] * (len(numbers) - 3) + [True] * 3


def test_the_folder_is_that_of_the_desktop_standard_unless_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv(FOLDER)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "mr360uw"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "mr360uw"


@pytest.mark.parametrize("mode", ["table", "plate"])
def test_tables_of_water_from_the_disk_are_those_that_were_computed(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def medium(kind: str, depth_m: float) -> Medium:
        return Medium(Water.jerlov(kind), mode=mode, camera_depth_m=depth_m, band_count=4)  # type: ignore[arg-type]

    waters = [("IB", 5.0), ("3C", 5.0), ("IB", 6.0)]
    tables = [[medium(*water).unit_table for water in waters] for _ in range(2)]
    monkeypatch.setenv(FOLDER, "")
    tables.append([medium(*water).unit_table for water in waters])
    for made, *others in zip(*tables, strict=True):
        for other in others:
            for name in ("veil", "attenuation", "diffuse", "beam", "unscattered"):
                np.testing.assert_array_equal(getattr(other, name), getattr(made, name))
    assert len({table.veil.tobytes() for table in tables[0]}) == len(waters)


def test_spread_and_shape_from_the_disk_are_those_that_were_computed(
    whale: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mr360uw.medium import scattered_light

    def spread() -> np.ndarray:
        scattered_light._weights.cache_clear()
        found = spread_of(Medium(Water.jerlov("IB"), band_count=4))
        assert found is not None
        return found.weight

    def stored(matrix: csr_matrix) -> tuple[np.ndarray, ...]:
        return matrix.data, matrix.indices, matrix.indptr, np.array(matrix.shape)

    def arrays(mesh: Mesh) -> list[np.ndarray]:
        transfer = make_transfer(mesh)
        lattice = transfer.lattice
        return [
            mesh.hull, mesh.patch, lattice.places, lattice.position, lattice.normal, lattice.triangle, lattice.weights,
            lattice.nearest_sample, *stored(lattice.from_samples), transfer.coarse, *stored(transfer.spread),
            transfer.nearest_coarse, *transfer.own, np.array([lattice.points, lattice.two_sided, transfer.spacing_m]),
        ]  # fmt: skip

    kept = [(spread(), *arrays(load_mesh(whale))) for _ in range(2)]
    monkeypatch.setenv(FOLDER, "")
    for made, read, alone in zip(*kept, (spread(), *arrays(load_mesh(whale))), strict=True):
        assert made.dtype == read.dtype == alone.dtype
        np.testing.assert_array_equal(read, made)
        np.testing.assert_array_equal(alone, made)


needs_owners = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have owners on POSIX")
OTHER = 54321
"""Number of another user."""


def give_away(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a file or folder another user's: truly as root, else by being another one."""
    if os.geteuid() == 0:
        os.chown(path, OTHER, OTHER)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: OTHER)


@needs_owners
def test_a_folder_of_another_user_is_not_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    make = Made()
    kept_arrays("test", ("a",), make)
    there = sorted((tmp_path / "kept").iterdir())
    give_away(tmp_path / "kept", monkeypatch)
    assert cache_folder() is None
    assert kernel_folder() is None or "NUMBA_CACHE_DIR" in os.environ
    for _ in range(2):
        kept_arrays("test", ("a",), make)
    assert make.count == 3
    assert sorted((tmp_path / "kept").iterdir()) == there
    (note,) = cache_notes()
    assert str(tmp_path) in note
    assert FOLDER in note


@needs_owners
@pytest.mark.parametrize("what", ["file", "folder", "above", "link"])
def test_what_others_can_change_is_not_read(what: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A file or a folder on the way that a group or all may write to, and a link into one."""
    above = tmp_path / "above"
    above.mkdir(0o755)
    named = tmp_path / "link" if what == "link" else above / "kept"
    if what == "link":
        (above / "kept").mkdir(0o755)
        named.symlink_to(above / "kept")
    monkeypatch.setenv(FOLDER, str(named))
    make = Made()
    for _ in range(2):
        kept_arrays("test", ("a",), make)
    assert make.count == 1
    path = cache_file("test", ("a",))
    assert path is not None
    open_one = {"file": path, "folder": above / "kept"}.get(what, above)
    open_one.chmod(0o775)
    kept_arrays("test", ("a",), make)
    assert make.count == 2
    # a file in a folder of one's own is made anew and is safe then
    kept_arrays("test", ("a",), make)
    assert make.count == (2 if what == "file" else 3)
    assert (cache_folder() is None) == (what != "file")


@needs_owners
def test_a_folder_open_to_all_may_be_above_where_its_sticky_bit_is_set(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    above = tmp_path / "like-tmp"
    above.mkdir()
    above.chmod(0o1777)
    monkeypatch.setenv(FOLDER, str(above / "kept"))
    make = Made()
    for _ in range(2):
        kept_arrays("test", ("a",), make)
    assert (make.count, cache_notes()) == (1, [])
    monkeypatch.setenv(FOLDER, str(above))  # where others can put files under names that are not taken
    assert cache_folder() is None


@needs_owners
def test_results_are_found_again_whatever_the_mask(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path / "above" / "kept"))
    make, before = Made(), os.umask(0)
    try:
        for _ in range(2):
            kept_arrays("test", ("a",), make)
    finally:
        os.umask(before)
    assert make.count == 1


def test_folders_that_the_environment_names_relatively(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The standard has a relative $XDG_CACHE_HOME ignored; our own variable counts from the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(FOLDER, "here")
    assert cache_folder() == tmp_path / "here"
    monkeypatch.delenv(FOLDER)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache_folder() == tmp_path / "home" / ".cache" / "mr360uw"


def test_a_folder_that_cannot_be_written_to_is_told(
    run: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "a file").touch()
    monkeypatch.setenv(FOLDER, str(tmp_path / "a file"))
    code, out, _ = run("info")
    assert code == 0
    assert f"note      cache - nothing new can be kept in {tmp_path / 'a file'} - " in out
    monkeypatch.setenv(FOLDER, "")
    assert "note      cache" not in run("info")[1]
