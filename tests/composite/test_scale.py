# SPDX-License-Identifier: Apache-2.0
"""The unit of a mesh is nobody's business: in centimetres and scaled by 1/100 it shades as in metres."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.mesh.material import Part
from mr360uw.composite.mesh.mesh import Mesh, make_mesh
from mr360uw.composite.reference import render_layer
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.types import Lamp, Layer
from tests.composite import tolerances as tol
from tests.composite.scenes import box, placed, shot


def table(unit_m: float) -> Mesh:
    """Return a plate 0.2 m above a larger one, which it shades, in units of some metres: one mesh."""
    top, floor = box((0.5, 0.05, 0.5)), box((1.2, 0.05, 1.2))
    raised = np.add(top.positions.reshape(-1, 3), [0.0, 0.2, 0.0])
    points = np.concatenate([raised, floor.positions.reshape(-1, 3)])
    return make_mesh([Part("table", points / unit_m, np.arange(len(points)).reshape(-1, 3))], top.materials[:1])


def rendered(scene: Shot, backend: str) -> Layer:
    return render_layer(scene) if backend == "reference" else LayerRenderer().render(scene)


@pytest.mark.parametrize("light", ["sun", "lamp"])
def test_a_mesh_in_centimetres_shades_itself_as_one_in_metres(light: str, backend: str) -> None:
    lamp = Lamp(np.array([-0.2, 1.2, -1.3]), np.array([0.0, -1.0, 0.0]), np.full(3, 3.0))
    lights = {"sun": None, "lamps": [lamp]} if light == "lamp" else {}
    scenes = [
        shot(placed(table(unit), (0.0, -0.8, -1.4), scale=unit), receiver=Receiver(plane_y=-0.9), **lights)
        for unit in (1.0, 0.01)
    ]
    metres, centimetres = (rendered(scene, backend) for scene in scenes)
    bare = rendered(shot(placed(box((1.2, 0.05, 1.2)), (0.0, -0.8, -1.4)), **lights), backend)
    both = (metres.alpha > 0.99) & (bare.alpha > 0.99)
    assert np.sum(metres.radiance[both] < 0.7 * bare.radiance[both]) > 50  # what the upper plate shades
    np.testing.assert_allclose(centimetres.alpha, metres.alpha, atol=tol.HALF_FLOAT)
    np.testing.assert_allclose(centimetres.radiance, metres.radiance, atol=tol.HALF_FLOAT)
    np.testing.assert_allclose(centimetres.ratio, metres.ratio, atol=tol.HALF_FLOAT)
