# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.cache import Cache, PartOf
from mr360uw.base.rays import barycentric
from mr360uw.base.sphere import directions, unit
from mr360uw.composite.gl.visible_surfaces import find_surfaces
from mr360uw.composite.mesh.material import Material, Part
from mr360uw.composite.mesh.mesh import make_mesh
from mr360uw.composite.sampling import pattern
from mr360uw.composite.shot import PlacedObject
from mr360uw.composite.tiles import even_tiles, rectangles_of_bodies, rectangles_of_mask
from mr360uw.errors import ParameterError
from tests.composite import tolerances as tol
from tests.composite.scenes import shot
from tests.glsl import glsl_call

COUNTS = (1, 5, 13, 17, 29, 41, 65)


@pytest.mark.parametrize("count", COUNTS)
def test_every_pixel_has_its_samples_in_different_rows_and_columns(count: int) -> None:
    p = pattern(count)
    assert p.count == count
    for axis in range(2):
        np.testing.assert_allclose(np.sort(p.positions[:, axis]), (np.arange(count) + 0.5) / count, atol=tol.FLOAT64)
    np.testing.assert_allclose(p.positions[0], 0.5, atol=tol.FLOAT64)
    # as far apart as the middles of squares that fill the pixel
    gaps = np.linalg.norm(p.positions[:, None] - p.positions, axis=-1) + 9.0 * np.eye(count)
    assert count == 1 or gaps.min() == pytest.approx(count**-0.5)


def test_unknown_counts_are_refused() -> None:
    with pytest.raises(ParameterError, match="take one of"):
        pattern(16)


def covered(corners: np.ndarray, width: int) -> np.ndarray:
    """Return the pixels whose centre's ray meets a triangle (3, 3)."""
    rays = directions(width, width // 2).reshape(-1, 3)
    weights, distance = barycentric(np.broadcast_to(corners, (len(rays), 3, 3)), rays)
    return (np.all(weights >= 0.0, axis=-1) & (distance > 0.0)).reshape(width // 2, width)


def test_rectangles_hold_triangles_over_seam_and_poles(rng: np.random.Generator) -> None:
    width, poles, slack = 128, 0, []
    for _ in range(300):
        corners = rng.normal(size=(3, 3)) + 1.5 * unit(rng.normal(size=3))
        mask = covered(corners, width)
        ((column, row, columns, rows),) = rectangles_of_bodies([corners[None]], width, width // 2)
        inside = np.zeros_like(mask)
        inside[row : row + rows, (column + np.arange(columns)) % width] = True
        assert not np.any(mask & ~inside)
        slack += [(columns - tight.width, rows - tight.height) for tight in rectangles_of_mask(mask, mask.size)]
        poles += bool(mask[0].all() or mask[-1].all())
    assert poles > 10
    assert np.all(np.median(slack, axis=0) <= tol.RECTANGLE_PIXELS)  # slender corners fall between pixel centres


def test_even_tiles_are_even_disjoint_and_inside(rng: np.random.Generator) -> None:
    rectangles = [(int(rng.integers(0, 64)), int(rng.integers(0, 25)), int(rng.integers(1, 30)), 5) for _ in range(6)]
    tiles = even_tiles(rectangles, 64, 32)
    claimed = np.zeros((32, 64), int)
    for column, row, width, height in tiles:
        assert not np.any(np.array([column, row, width, height]) % 2)
        assert column + width <= 64
        claimed[row : row + height, column : column + width] += 1
    assert claimed.max() == 1
    for column, row, width, height in rectangles:
        assert np.all(claimed[row : row + height][:, (column + np.arange(width)) % 64] == 1)


@pytest.mark.parametrize(("width", "height"), [(1000, 500), (1003, 501), (6, 3)])
def test_tiles_keep_inside_frames_of_any_size(width: int, height: int, rng: np.random.Generator) -> None:
    for _ in range(20):
        claimed, wanted = np.zeros((height, width), int), np.zeros((height, width), bool)
        rectangles = []
        for _ in range(4):
            column, row = int(rng.integers(width)), int(rng.integers(height))
            columns, rows = int(rng.integers(1, width // 2)), int(rng.integers(1, height - row + 1))
            rectangles.append((column, row, columns, rows))
            wanted[row : row + rows, (column + np.arange(columns)) % width] = True
        for column, row, columns, rows in even_tiles(rectangles, width, height):
            assert column % 2 == row % 2 == 0
            assert columns % 2 == 0 or column + columns == width
            assert rows % 2 == 0 or row + rows == height
            assert min(columns, rows) > 0
            assert column + columns <= width
            assert row + rows <= height
            claimed[row : row + rows, column : column + columns] += 1
        assert claimed.max() == 1
        assert np.all(claimed[wanted] == 1)


def test_one_rectangle_is_one_tile_no_wider_than_chroma_asks() -> None:
    assert even_tiles([(101, 203, 30, 21)], 1000, 500) == [(100, 202, 32, 22)]


def test_tiles_leave_out_what_is_far_apart() -> None:
    assert even_tiles([], 1000, 500) == []
    assert sorted(even_tiles([(980, 100, 40, 10), (400, 0, 20, 20), (410, 400, 100, 50)], 1000, 500)) == [
        (0, 100, 20, 10), (400, 0, 20, 20), (410, 400, 100, 50), (980, 100, 20, 10)
    ]  # fmt: skip


@pytest.mark.usefixtures("gl")
def test_rays_on_the_device_are_the_references(rng: np.random.Generator) -> None:
    count = 2000
    corners = (rng.normal(size=(count, 3, 3)) + 3.0 * unit(rng.normal(size=(count, 1, 3)))).astype(np.float32)
    towards = unit(np.einsum("nc,nck->nk", rng.dirichlet([1, 1, 1], count), corners)).astype(np.float32)
    a, b, c = (corners[:, k] for k in range(3))
    weights, distance = barycentric(corners.astype(float), towards.astype(float))
    got = glsl_call(
        "composite/gl/shaders/geometry.glsl", "barycentric(make_facet(a, b, c), d)", 4, a=a, b=b, c=c, d=towards
    )
    volume = np.abs(np.sum(a * np.cross(b, c), -1))
    fair = volume > np.quantile(volume, 0.05)  # slivers seen edge-on lose digits
    np.testing.assert_allclose(got[fair, :3], weights[fair], atol=tol.FLOAT32_LOOKUP)
    np.testing.assert_allclose(got[fair, 3], distance[fair], rtol=tol.FLOAT32_LOOKUP)


def test_fragments_hold_the_samples_that_rays_find_over_seam_and_poles(rng: np.random.Generator) -> None:
    width, samples, poles, pieces = 64, pattern(17), 0, 0
    for _ in range(40):
        corners = rng.normal(size=(3, 3, 3)) + 1.5 * unit(rng.normal(size=(3, 1, 3)))
        part = Part("", corners.reshape(-1, 3), np.arange(9).reshape(3, 3))
        mesh = make_mesh([part], [Material(double_sided=True)])
        scene = shot(PlacedObject(mesh, np.eye(4)), width=width, samples=samples.count)
        view = scene.view
        row, column = (a.ravel() for a in np.mgrid[0 : view.height, 0:width])
        # the nearest triangle along the rays of all samples, one by one
        x, y = column[:, None] + samples.positions[:, 0], row[:, None] + samples.positions[:, 1]
        rays = view.directions(x.ravel(), y.ravel())
        nearest, depth = np.full(len(rays), -1), np.full(len(rays), np.inf)
        for number, triangle in enumerate(mesh.positions - view.position):
            weights, distance = barycentric(np.broadcast_to(triangle, (len(rays), 3, 3)), rays)
            hit = np.all(weights >= 0.0, axis=-1) & (distance > 0.0) & (distance < depth)
            nearest[hit], depth[hit] = number, distance[hit]
        covered = (nearest >= 0).reshape(-1, samples.count).mean(axis=1).reshape(view.height, width)
        surfaces = find_surfaces(PartOf(scene), list(scene.visible), Cache())
        got = np.zeros((view.height, width))
        for layer in surfaces.layers:
            pixel = layer.pixel()
            np.add.at(got, (layer.row[pixel], layer.column[pixel]), layer.weight)
            pieces += len(layer.triangle)
        assert np.mean(np.abs(got - covered) > 0.5 / samples.count) <= tol.SAMPLES_AT_EDGES
        poles += bool(covered[0].all() or covered[-1].all())
    assert poles > 2
    assert pieces > 1000
