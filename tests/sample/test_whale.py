# SPDX-License-Identifier: Apache-2.0
"""The sample whale: one closed skin with the proportions of a humpback, maps, a skeleton, and a stroke that repeats."""

from __future__ import annotations

import importlib
import io
import json
import struct
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.signal import find_peaks

from mr360uw.composite.mesh.mesh import read_mesh_file
from mr360uw.first_look.observations import look_at_mesh
from mr360uw.sample.dive import write_whale
from mr360uw.types import Floats

LENGTH_M = 13.5


@pytest.fixture(scope="module")
def fine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fine") / "whale.glb"
    write_whale(path)
    return path


@pytest.fixture(scope="module")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("coarse") / "whale.glb"
    write_whale(path, detail="low")
    return path


def opened(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the binary chunk of a .glb."""
    data = path.read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


read = cache(read_mesh_file)


@cache
def closed(path: Path) -> trimesh.Trimesh:
    """Return the skin at rest, vertices at seams of the maps joined."""
    (part,) = read(path).parts
    corners = part.positions[part.faces].reshape(-1, 3)
    return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=True)


def poses(path: Path, times_s: Floats) -> Floats:
    """Return the vertices (k, V, 3) at times of the clip."""
    file = read(path)
    assert file.rigging is not None
    clip = file.rigging.read_clip(0)
    (body,) = file.rigging.bodies
    return np.stack([body.at(file.rigging.skeleton.at(clip, float(time)))[0] for time in times_s])


@pytest.mark.parametrize(("detail", "fewest", "most"), [("fine", 10_000, 25_000), ("coarse", 1500, 2500)])
def test_it_is_one_closed_skin(detail: str, fewest: int, most: int, request: pytest.FixtureRequest) -> None:
    skin = closed(request.getfixturevalue(detail))
    assert skin.is_watertight
    assert skin.is_winding_consistent
    assert skin.body_count == 1
    assert skin.euler_number == 2  # of a ball: no handle, as fins that touch each other would make
    assert fewest <= len(skin.faces) <= most


@pytest.mark.parametrize("detail", ["fine", "coarse"])
def test_it_has_the_proportions_of_a_humpback(detail: str, request: pytest.FixtureRequest) -> None:
    path = request.getfixturevalue(detail)
    skin = closed(path)
    s = 0.5 - skin.vertices[:, 2] / LENGTH_M
    x, y = skin.vertices[:, 0] / LENGTH_M, skin.vertices[:, 1] / LENGTH_M
    # Lockyer (1976), table 1: 16.473 L^2.95 kg; by season a whale weighs a quarter more or less. Its density is water's
    assert skin.volume * 1030.0 == pytest.approx(16.473 * LENGTH_M**2.95, rel=0.25)
    # Length from the snout to the notch between the flukes, whose lobes reach behind it by less than a tenth of it
    assert s.min() == pytest.approx(0.0, abs=1e-3)
    assert s[(np.abs(x) < 0.004) & (s > 0.95)].max() == pytest.approx(1.0, abs=0.01)
    assert 1.0 < s.max() < 1.1
    # Span of the flukes a third of the length, pectorals a quarter to a third of it (Fish & Battle 1995)
    assert np.ptp(x[s > 0.9]) == pytest.approx(1.0 / 3.0, abs=0.03)
    pectoral = (s > 0.28) & (x > 0.09) & (s < 0.75)
    root, tip = np.array([0.095, -0.045, 0.325]), np.array([x, y, s]).T[pectoral][np.argmax(x[pectoral])]
    assert 0.25 < np.linalg.norm(tip - root) < 0.34
    # The body is widest behind the head, and there a fifth of its length wide
    trunk = (np.abs(y) < 0.02) & (s > 0.40) & (s < 0.45)
    assert np.ptp(x[trunk]) == pytest.approx(0.21, abs=0.02)
    # The dorsal fin is the highest point, two thirds from the snout
    assert s[np.argmax(y)] == pytest.approx(2.0 / 3.0, abs=0.04)


def test_the_leading_edge_of_a_pectoral_has_its_tubercles(fine: Path) -> None:
    skin = closed(fine)
    # Foremost point of each cut across the left fin, less a smooth line along the fin
    cuts = np.arange(0.12, 0.31, 0.0022) * LENGTH_M
    edge = np.array([skin.section((1.0, 0.0, 0.0), (x, 0.0, 0.0)).vertices[:, 2].max() for x in cuts])
    waves = edge - np.polynomial.Polynomial.fit(cuts, edge, 4)(cuts)
    peaks, _ = find_peaks(waves, prominence=0.0008 * LENGTH_M)
    assert 8 <= len(peaks) <= 11  # ten, of which the first may be hidden in the root and the last in the tip


def test_it_swims_to_the_front_which_is_plus_z(fine: Path, coarse: Path) -> None:
    for path in (fine, coarse):
        look = look_at_mesh(path)
        assert (look.front, look.habit, look.clips) == ("+z", "swims", ("swim",))
        assert look.kind is not None
        assert look.kind.word == "whale"
        assert look.size_m == pytest.approx(LENGTH_M, rel=0.06)


def test_extras_name_the_species_and_its_length(coarse: Path, tmp_path: Path) -> None:
    write_whale(tmp_path / "calf.glb", 4.0, detail="low")
    for path, length_m in ((coarse, LENGTH_M), (tmp_path / "calf.glb", 4.0)):
        tree, _ = opened(path)
        for extras in (tree["asset"]["extras"], tree["nodes"][0]["extras"]):
            assert extras["species"] == "Megaptera novaeangliae"
            assert extras["length_m"] == length_m


def test_the_file_is_small_and_its_maps_are_fine(fine: Path) -> None:
    assert fine.stat().st_size < 2_500_000
    tree, data = opened(fine)
    views = [tree["bufferViews"][image["bufferView"]] for image in tree["images"]]
    pictures = [data[v["byteOffset"] : v["byteOffset"] + v["byteLength"]] for v in views]
    assert [Image.open(io.BytesIO(picture)).size for picture in pictures] == [(2048, 2048)] * 3
    (material,) = read(fine).materials
    assert material.base_map is not None
    assert material.metallic_roughness_map is not None
    assert material.normal_map is not None
    assert material.metallic == 0.0


def test_the_back_is_dark_and_the_belly_pale(fine: Path) -> None:
    (part,), (material,) = read(fine).parts, read(fine).materials
    assert material.base_map is not None
    assert part.normals is not None
    assert part.uv is not None
    picture = material.base_map.levels[0]
    middle, outwards = (column[part.faces].mean(axis=1) for column in (part.positions, part.normals))
    up = outwards[:, 1] / np.linalg.norm(outwards, axis=-1)
    u, v = np.moveaxis(part.uv[part.faces].mean(axis=1), -1, 0)
    height, width = picture.shape[:2]
    albedo = picture[(v * height).astype(int), (u * width).astype(int), 1]
    trunk = np.abs(middle[:, 2]) < 0.3 * LENGTH_M
    back, belly = albedo[trunk & (up > 0.7)], albedo[trunk & (up < -0.9)]
    assert np.median(belly) > 6.0 * np.median(back)
    assert np.percentile(back, 99) < np.percentile(belly, 50)


@pytest.mark.parametrize("detail", ["fine", "coarse"])
def test_weights_sum_to_one_and_change_smoothly(detail: str, request: pytest.FixtureRequest) -> None:
    path = request.getfixturevalue(detail)
    tree, data = opened(path)
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]

    def column(name: str, kind: type) -> np.ndarray:
        accessor = tree["accessors"][attributes[name]]
        start = tree["bufferViews"][accessor["bufferView"]]["byteOffset"]
        return np.frombuffer(data, kind, 4 * accessor["count"], start).reshape(-1, 4).astype(np.int64)

    joints, codes = column("JOINTS_0", np.uint8), column("WEIGHTS_0", np.uint16)
    assert np.all(codes.sum(axis=1) == 65535)
    assert 10 <= len(tree["skins"][0]["joints"]) <= 16
    assert joints.max() < len(tree["skins"][0]["joints"])
    assert read(path).notes == ()  # nothing that the reader had to mend
    # Along no edge does a joint take over more than a quarter; edges of the coarse skin are three times as long
    weights = np.zeros((len(codes), len(tree["skins"][0]["joints"])))
    for k in range(4):
        weights[np.arange(len(codes)), joints[:, k]] += codes[:, k] / 65535.0
    file = read(path)
    faces = file.parts[0].faces
    step = np.abs(weights[faces] - weights[np.roll(faces, 1, axis=1)]).max()
    assert step < (0.25 if detail == "fine" else 0.6)


def test_the_stroke_repeats_and_beats_the_flukes(coarse: Path) -> None:
    period_s = 4.0
    times = np.linspace(0.0, period_s, 17)
    moved = poses(coarse, times) / LENGTH_M
    np.testing.assert_allclose(moved[-1], moved[0], atol=1e-7)
    s = 0.5 - read(coarse).parts[0].positions[:, 2] / LENGTH_M
    heights = moved[:, :, 1]
    swing = np.ptp(heights, axis=0)
    # Flukes rise and fall by about a fifth of the length (Fish 1998); the head is nearly still
    assert 0.14 < np.median(swing[s > 0.95]) < 0.24
    assert swing[s < 0.15].max() < 0.03
    # The wave runs towards the tail: the stock is highest before the flukes are
    stock, flukes = (heights[:, (s > a) & (s < b)].mean(axis=1)[:-1] for a, b in ((0.70, 0.76), (0.96, 1.0)))
    lag = (np.angle(np.fft.rfft(stock)[1]) - np.angle(np.fft.rfft(flukes)[1])) % (2.0 * np.pi)
    assert 0.1 * np.pi < lag < 0.6 * np.pi


def test_the_skin_neither_tears_nor_folds_while_it_swims(coarse: Path) -> None:
    faces = read(coarse).parts[0].faces
    rest = closed(coarse).volume
    for points in poses(coarse, np.array([0.0, 1.0, 2.0, 3.0])):
        body = trimesh.Trimesh(points, faces, process=True)
        body.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=4)
        assert body.is_watertight
        assert body.volume == pytest.approx(rest, rel=0.02)


def test_the_stored_whale_is_what_its_program_makes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "samples" / "humpback"))
    made = importlib.import_module("make").humpback_file("low")
    (tmp_path / "made.glb").write_bytes(made)
    write_whale(tmp_path / "stored.glb", 1.0, detail="low")
    (new,), (old,) = (read(tmp_path / name).parts for name in ("made.glb", "stored.glb"))
    np.testing.assert_allclose(new.positions, old.positions, atol=1e-6)  # another processor rounds otherwise
    np.testing.assert_array_equal(new.faces, old.faces)
    np.testing.assert_allclose(
        *(poses(tmp_path / name, np.array([0.7])) for name in ("made.glb", "stored.glb")), atol=1e-6
    )


def test_a_rigid_whale_has_no_clip(tmp_path: Path) -> None:
    write_whale(tmp_path / "rigid.glb", 2.0, detail="low", swims=False)
    file = read(tmp_path / "rigid.glb")
    assert file.rigging is None
    assert np.ptp(file.parts[0].positions[:, 2]) == pytest.approx(2.0, rel=0.06)


def test_a_calf_swims_as_a_grown_whale_does(tmp_path: Path, coarse: Path) -> None:
    write_whale(tmp_path / "calf.glb", 0.5 * LENGTH_M, detail="low")
    times = np.array([0.0, 1.3])
    np.testing.assert_allclose(2.0 * poses(tmp_path / "calf.glb", times), poses(coarse, times), atol=2e-6 * LENGTH_M)
