# SPDX-License-Identifier: Apache-2.0
"""Arbitrary and slightly damaged bytes: readers answer with their own errors, whatever they are given."""

from __future__ import annotations

import json
import random
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mr360uw.base.input_files import picture_size
from mr360uw.composite import load_mesh
from mr360uw.errors import Mr360uwError
from mr360uw.ibl.tilt import level_at, level_from_gpmf
from mr360uw.scene.model import Scene, load_scene
from mr360uw.video import read_exr, read_spherical
from mr360uw.video.spherical import parse_boxes, read_moov, sample_entries, video_track
from tests import gpmf
from tests.composite.gltf_files import one_square, swimming
from tests.hostile.bench import Material
from tests.video.clips import write_clip

few = settings(max_examples=25, deadline=None, derandomize=True, database=None,
               suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(allow_nan=True), st.text(max_size=8)
)
JSON = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=8,
)
TOML_VALUES = st.recursive(
    st.one_of(
        st.booleans().map(lambda b: str(b).lower()), st.integers().map(str), st.floats().map(repr),
        st.text("abc \\u00e9'", max_size=6).map(json.dumps), st.just("1979-05-27"), st.just("07:32:00"),
    ),
    lambda inner: st.lists(inner, max_size=3).map(lambda items: f"[{', '.join(items)}]")
    | st.dictionaries(st.sampled_from("abxyz"), inner, max_size=3).map(
        lambda table: "{" + ", ".join(f"{k} = {v}" for k, v in table.items()) + "}"
    ),
    max_leaves=6,
)  # fmt: skip
KEYS = sorted(
    {
        name
        for field in Scene.model_fields.values()
        for model in [field.annotation]
        for name in getattr(model, "model_fields", {})
    }
    | {"kind", "path", "model", "x y"}
)
LINES = st.one_of(
    st.builds(lambda key, value: f"{json.dumps(key)} = {value}", st.sampled_from(KEYS), TOML_VALUES),
    st.builds(lambda name: f"[{name}]", st.sampled_from([f.alias or n for n, f in Scene.model_fields.items()])),
    st.builds(lambda name: f"[[{name}]]", st.sampled_from(["object", "lamp", "holdout", "object.key", "plate"])),
    st.text(max_size=12),
)


def damaged(data: bytes, seed: int) -> bytes:
    """Return bytes with some of them changed, removed, doubled, or cut off."""
    chance = random.Random(seed)
    changed = bytearray(data)
    for _ in range(chance.randint(1, 8)):
        if not changed:
            break
        at = chance.randrange(len(changed))
        action = chance.randrange(5)
        if action < 3:
            changed[at] = chance.choice([0, 1, 127, 128, 255, chance.randrange(256)])
        elif action == 3:
            del changed[at : at + chance.randint(1, 16)]
        else:
            changed[at:at] = changed[at : at + chance.randint(1, 16)]
    return bytes(changed[: chance.randrange(len(changed))] if changed and chance.random() < 0.2 else changed)


def place(tree: Any, value: Any, seed: int) -> None:
    """Put a value somewhere into nested lists and dictionaries."""
    chance = random.Random(seed)
    while isinstance(tree, dict | list) and tree:
        key = chance.choice(list(tree)) if isinstance(tree, dict) else chance.randrange(len(tree))
        inner = tree[key]
        if not isinstance(inner, dict | list) or not inner or chance.random() < 0.25:
            tree[key] = value
            return
        tree = inner


@few
@given(st.lists(LINES, max_size=8).map("\n".join))
def test_scenes(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with suppress(Mr360uwError):
        load_scene(path)


@few
@given(st.binary(max_size=200))
def test_bytes(tmp_path: Path, data: bytes) -> None:
    for name in ("a.glb", "a.gltf", "a.obj", "a.ply", "a.stl"):
        (tmp_path / name).write_bytes(data)
        with suppress(Mr360uwError):
            load_mesh(tmp_path / name)
    (tmp_path / "scene.toml").write_bytes(data)
    with suppress(Mr360uwError):
        load_scene(tmp_path / "scene.toml")
    with suppress(Mr360uwError):
        level_from_gpmf(data, 25.0)
    with suppress(ValueError):
        parse_boxes(data)
    for head in (b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"II*\0", b"MM\0*", b"BM", b"RIFF\0\0\0\0WEBPVP8X", b"#?"):
        size = picture_size(head + data)
        assert size is None or min(size) >= 0


@few
@given(JSON, st.integers(0, 2**32), st.booleans())
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_gltf_with_a_value_somewhere(tmp_path: Path, value: Any, seed: int, moves: bool) -> None:
    file = swimming(sections=3, sides=3) if moves else one_square()
    place(file.tree, value, seed)
    try:
        path = file.write(tmp_path / "mesh.glb")
    except (TypeError, KeyError):
        return  # no longer a tree that is written
    with suppress(Mr360uwError):
        load_mesh(path)


@few
@given(st.sampled_from(["mesh.glb", "plate.exr"]), st.integers(0, 2**32))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_damaged_files(tmp_path: Path, material: Material, name: str, seed: int) -> None:
    path = tmp_path / name
    path.write_bytes(damaged(material.files[name], seed))
    with suppress(Mr360uwError):
        (read_exr if name.endswith("exr") else load_mesh)(path)


@few
@given(st.integers(0, 2**32))
def test_damaged_gravity(seed: int) -> None:
    up = np.tile([0.0, 1.0, 0.0], (3, 1))
    with suppress(Mr360uwError):
        track = level_from_gpmf(damaged(gpmf.payload(up), seed), 25.0)
        assert np.all(np.isfinite(level_at(track, 0.0)))


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_clip(tmp_path_factory.mktemp("clip") / "clip.mp4", 2, size=(64, 32)).read_bytes()


@few
@given(st.integers(0, 2**32))
def test_damaged_boxes(tmp_path: Path, clip: bytes, seed: int) -> None:
    path = tmp_path / "clip.mp4"
    at = clip.index(b"moov") - 4
    path.write_bytes(clip[:at] + damaged(clip[at:], seed))
    with suppress(Mr360uwError):
        read_spherical(path)
    moov = read_moov(path)
    track = None if moov is None else video_track(moov)
    if track is not None:
        assert isinstance(sample_entries(track), list)
