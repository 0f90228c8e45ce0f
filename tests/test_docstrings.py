# SPDX-License-Identifier: Apache-2.0
"""Public names, those on the page of calls: numpydoc sections without a fault, names that exist, examples that run."""

from __future__ import annotations

import doctest
import importlib
import operator
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpydoc.validate import validate

import mr360uw as uw

PAGE = Path(__file__).resolve().parents[1] / "docs" / "api.md"


def public_names() -> dict[str, Any]:
    """Return the objects of the page of calls by the path that the page gives, with the members that it shows."""
    found: dict[str, Any] = {}
    text = PAGE.read_text("utf-8")
    for path, members in re.findall(r"^::: (\S+)\n(?:    options: \{members: \[(.*)\]\})?", text, re.M):
        module, _, name = path.rpartition(".")
        found[path] = getattr(importlib.import_module(module), name)
        for member in filter(None, members.split(", ")):
            found[f"{path}.{member}"] = getattr(found[path], member)
    return found


PUBLIC = public_names()


def test_the_page_has_what_a_notebook_needs() -> None:
    assert len(PUBLIC) > 80
    assert {PUBLIC["mr360uw.runs.compositor.Compositor.frame"], PUBLIC["mr360uw.ibl.lighting.environment"]}
    listed = set(PUBLIC.values())
    for room in (uw.datasets, uw.ibl, uw.medium, uw.caustics, uw.surface):
        assert any(getattr(room, name) in listed for name in dir(room) if callable(getattr(room, name)))


@pytest.mark.parametrize("path", PUBLIC)
def test_numpydoc_finds_no_fault(path: str) -> None:
    assert not validate(path)["errors"]


@pytest.mark.parametrize("path", PUBLIC)
def test_names_to_see_also_exist(path: str) -> None:
    names = re.findall(r"^ *uw\.([\w.]+) : ", PUBLIC[path].__doc__, re.M)
    assert names
    assert all(operator.attrgetter(name)(uw) for name in names)


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The names that examples start from: a small dive, in whose folder they run."""
    dive = uw.sample_dive(tmp_path_factory.mktemp("examples") / "dive", width=64, frames=2)
    with uw.open_video(dive.plate) as video:
        plate = next(video.frames(1)).image_linear
    coarse = ["water.bands=8", "draw.samples=1", "caustics.size=64", "caustics.grid=32", "caustics.planes=2"]
    scene = uw.load_scene(dive.scene, coarse)  # solved and drawn in a fraction of the time
    return {"uw": uw, "np": np, "scene": scene, "plate": plate, "folder": dive.plate.parent}


@pytest.mark.parametrize("path", PUBLIC)
def test_the_example_runs(path: str, names: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(names["folder"])
    (names["folder"] / path).mkdir()
    for name in ("dive.mp4", "whale.glb", "scene.toml"):
        os.link(names["folder"] / name, names["folder"] / path / name)
    monkeypatch.chdir(names["folder"] / path)
    text = PUBLIC[path].__doc__
    assert re.search(r"^ *Examples\n *-{8}$", text, re.M), f"{path} has no example"
    test = doctest.DocTestParser().get_doctest(text, dict(names), path, None, None)
    assert test.examples
    said: list[str] = []
    np.set_printoptions(legacy=False)  # colour-science sets an older form for the whole process
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    assert not said, "".join(said)
