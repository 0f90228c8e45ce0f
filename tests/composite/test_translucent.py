# SPDX-License-Identifier: Apache-2.0
"""Light through surfaces of alphaMode BLEND: a surface of alpha a leaves 1 - a of it, on the ground and on bodies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.cache import Cache, shared
from mr360uw.composite import load_mesh
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.light_sources import casting_bodies
from mr360uw.composite.mesh.material import Material, Part, make_texture
from mr360uw.composite.mesh.mesh import Mesh, make_mesh
from mr360uw.composite.reference import render_layer
from mr360uw.composite.shot import PlacedObject, Receiver, Shot
from mr360uw.types import Layer, Sun
from tests.composite import tolerances as tol
from tests.composite.gltf_files import GltfFile
from tests.composite.scenes import codes, environment, placed, quad, shot, sphere
from tests.composite.test_receiver import assert_agrees

ABOVE = Sun(np.array([0.0, 1.0, 0.0]), np.ones(3), 0.01, 1.0)
BLACK = Material(base_color=(0.0, 0.0, 0.0, 1.0), roughness=1.0, refractive_index=1.0, double_sided=True)
BELOW = (43, 64)
"""Row and column of a frame 128 pixels wide that show the ground below the panes."""


@shared(keep=1)
def gl_renderer() -> LayerRenderer:
    """One for the file: it keeps its shaders."""
    return LayerRenderer()


def draw(backend: str, scene: Shot) -> Layer:
    """Return the layer by one of the renderers."""
    return render_layer(scene) if backend == "reference" else gl_renderer().render(scene)


def pane(alpha: float, by: str = "factor") -> Mesh:
    """Return a black pane that blocks a part of the light, by its factor, its map, its vertices or all of them."""
    if by == "opaque":
        return quad(BLACK, 2.0)
    part = {"factor": (alpha, 1.0, 1.0), "map": (1.0, alpha, 1.0), "vertices": (1.0, 1.0, alpha)}
    factor, of_map, of_vertices = part.get(by, (np.cbrt(alpha),) * 3)
    texture = make_texture(np.full((4, 4, 4), (0, 0, 0, round(65535 * of_map)), np.uint16), srgb=False)
    clear = replace(BLACK, base_color=(0.0, 0.0, 0.0, float(factor)), alpha_mode="BLEND", base_map=texture)
    mesh = quad(clear, 2.0)
    colors = mesh.colors.copy()
    colors[..., 3] = of_vertices
    return replace(mesh, colors=colors)


def under(*panes: Mesh, sun: Sun | None = ABOVE, occlusion: bool = False, **more: bool) -> Shot:
    """Return a shot of level ground below panes, which the camera does not see."""
    floor = Receiver(plane_y=-1.2, occlusion=occlusion)
    bodies = [
        placed(mesh, (0.0, -0.3 + 0.1 * k, -2.4), (0, -90, 0), visible=False, **more) for k, mesh in enumerate(panes)
    ]
    return shot(*bodies, sun=sun, receiver=floor, environment=environment(0.5), camera_position=np.array([0, 0.3, 0]))


@pytest.mark.parametrize("by", ["factor", "map", "vertices", "all"])
def test_a_pane_leaves_half_the_light_and_two_leave_a_quarter(backend: str, by: str) -> None:
    def lost(*panes: Mesh) -> float:
        return float(1.0 - draw(backend, under(*panes)).ratio[BELOW][1])

    whole = lost(pane(1.0, "opaque"))
    assert whole > 0.3
    assert lost(pane(0.5, by)) / whole == pytest.approx(0.5, abs=tol.HALF_FLOAT)
    if by == "factor":
        assert lost(pane(0.5), pane(0.5)) / whole == pytest.approx(0.75, abs=tol.HALF_FLOAT)
        assert lost(joined_panes()) / whole == pytest.approx(0.75, abs=tol.HALF_FLOAT)
        assert lost(pane(1.0)) / whole == pytest.approx(1.0, abs=tol.HALF_FLOAT)
        assert lost(pane(0.0)) == 0.0


def joined_panes() -> Mesh:
    """Return two panes of alpha 0.5 as one mesh."""
    one = pane(0.5)
    points = one.positions.reshape(-1, 3)
    corners = np.concatenate([points, points + np.array([0.0, 0.0, 0.2])])
    return make_mesh([Part("two", corners, np.arange(len(corners)).reshape(-1, 3))], list(one.materials))


def test_bodies_between_panes_are_lit_through_those_above(backend: str) -> None:
    """White ground is drawn as a body: the pane below it does not count."""
    white = replace(BLACK, base_color=(1.0, 1.0, 1.0, 1.0))
    ground = placed(quad(white, 1.0), (0.0, -0.8, -1.5), (0, -90, 0))
    dark = environment(0.0)

    def light(*heights: float) -> float:
        panes = [placed(pane(0.5), (0.0, y, -1.5), (0, -90, 0), visible=False) for y in heights]
        layer = draw(backend, shot(ground, *panes, sun=ABOVE, environment=dark))
        return float(layer.radiance[42, 64, 1])

    whole = light()
    assert light(-0.4) / whole == pytest.approx(0.5, abs=tol.HALF_FLOAT)
    assert light(-0.4, -0.9) / whole == pytest.approx(0.5, abs=tol.HALF_FLOAT)
    assert light(-0.4, -0.5) / whole == pytest.approx(0.25, abs=tol.HALF_FLOAT)


def test_ambient_light_is_lost_by_alpha(backend: str) -> None:
    """A black pane over the ground, and over a ball: half as much as an opaque one takes."""
    ball = placed(sphere(material=replace(BLACK, base_color=(0.8, 0.8, 0.8, 1.0))), (0.0, -0.9, -1.8))

    def ground(mesh: Mesh) -> float:
        return float(1.0 - draw(backend, under(mesh, sun=None, occlusion=True)).ratio[BELOW][1])

    def body(*panes: Mesh) -> float:
        over = [placed(mesh, (0.0, -0.2, -1.8), (0, -90, 0), visible=False) for mesh in panes]
        layer = draw(backend, shot(ball, *over, sun=None, environment=environment(0.5)))
        row, column = np.argwhere(layer.alpha == 1.0)[0]
        return float(layer.radiance[row + 1, column, 1])

    opaque = ground(pane(1.0, "opaque"))
    assert opaque > 0.2
    assert ground(pane(0.5)) == pytest.approx(0.5 * opaque, abs=tol.HALF_FLOAT)
    assert ground(pane(0.0)) == 0.0
    free, dark = body(), body(pane(1.0, "opaque"))
    assert dark < 0.7 * free
    assert body(pane(0.5)) == pytest.approx(0.5 * (free + dark), rel=tol.HALF_FLOAT * 4)
    assert body(pane(0.0)) == pytest.approx(free, rel=tol.HALF_FLOAT)


def test_light_in_the_water_passes_by_alpha() -> None:
    """Light from above at a point below: of one pane, of two, and of a closed ball of two surfaces."""
    up, point = np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, -1.0, -2.4]])

    def left(*panes: Mesh) -> float:
        return float(casting_bodies(under(*panes), Cache()).visible(point, up)[0])

    assert left(pane(1.0, "opaque")) == 0.0
    assert left(pane(0.5)) == pytest.approx(0.5)
    assert left(pane(0.5), pane(0.5)) == pytest.approx(0.25)
    assert left(pane(0.5), pane(1.0, "opaque")) == 0.0
    ball = sphere(material=replace(BLACK, base_color=(0.0, 0.0, 0.0, 0.5), alpha_mode="BLEND"))
    assert left(ball) == pytest.approx(0.25, abs=0.02)  # some rays of the mean graze it


def test_blend_that_is_closed_everywhere_is_opaque(tmp_path: Path) -> None:
    """BLEND of alpha 1 is drawn as OPAQUE, to the bit; not so where a texel is clear."""
    modes = {}
    for name, texel in (("closed", 255), ("open", 254)):
        file = GltfFile()
        image = np.full((4, 4, 4), 255, np.uint8)
        image[0, 0, 3] = texel
        pbr = {"baseColorTexture": {"index": file.texture(image)}}
        file.tree["materials"] = [{"alphaMode": "BLEND", "pbrMetallicRoughness": pbr}]
        file.mesh(file.square(material=0))
        modes[name] = [m.alpha_mode for m in load_mesh(file.write(tmp_path / f"{name}.glb")).materials]
    assert modes == {"closed": ["OPAQUE"], "open": ["BLEND"]}


@pytest.mark.usefixtures("gl")
def test_both_renderers_agree_on_a_ball_that_lets_light_through() -> None:
    """A two-sided ball of alpha 0.6 over white ground, with a small solid one in it."""
    shell = replace(BLACK, base_color=(0.7, 0.3, 0.2, 0.6), alpha_mode="BLEND")
    bodies = (
        placed(sphere(material=shell), (0.0, -0.6, -1.8)),
        PlacedObject(sphere(radius=0.15), placed(sphere(), (0.1, -0.6, -1.8)).world_from_object),
    )
    scene = shot(*bodies, receiver=Receiver(plane_y=-1.2), width=128, environment=environment())
    expected, got = (draw(backend, scene) for backend in ("reference", "gl"))
    assert np.max(np.abs(codes(got.radiance) - codes(expected.radiance))) <= tol.RENDERERS_CODES
    assert_agrees(got.ratio, expected.ratio)
