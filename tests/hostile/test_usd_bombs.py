# SPDX-License-Identifier: Apache-2.0
"""USD files that make more than they hold, or name files elsewhere."""

from __future__ import annotations

import pytest

from tests.hostile.bench import Bench

pytest.importorskip("pxr", reason="needs mr360uw[usd]")

SQUARE = """def Mesh "square" {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
}
"""


def test_references_that_multiply(bench: Bench) -> None:
    """Nine levels of ten references each: a billion squares in fifty lines."""
    levels = [SQUARE.replace("square", "level0")]
    for level in range(1, 10):
        below = "\n".join(f'def "part{k}" (references = </level{level - 1}>) {{}}' for k in range(10))
        levels.append(f'def Xform "level{level}" {{\n{below}\n}}\n')
    bench.put("bomb.usda", '#usda 1.0\n(defaultPrim = "level9")\n' + "".join(levels))
    bench.refuses_with('object.0.mesh="bomb.usda"', says=("bomb.usda", "MR360UW_MAX_PRIMS"))
    few = '#usda 1.0\n(defaultPrim = "level2")\n' + "".join(levels[:3])
    bench.put("few.usda", few)
    code, _, err = bench.run("composite", "scene.toml", "out.png", "--backend", "reference", "--set",
                             'object.0.mesh="few.usda"', "--set", "draw.samples=1")  # fmt: skip
    assert (code, err) == (0, "")


def test_an_instancer_of_itself(bench: Bench) -> None:
    bench.put(
        "self.usda",
        """#usda 1.0
def PointInstancer "many" {
    rel prototypes = [</many>, </many/square>]
    int[] protoIndices = [0, 1]
    point3f[] positions = [(0, 0, 0), (1, 0, 0)]
    """
        + SQUARE
        + "}\n",
    )
    bench.refuses_with('object.0.mesh="self.usda"', says=("self.usda", "repeats itself"))


def test_value_clips_stay_in_the_folder(bench: Bench) -> None:
    bench.put(
        "clips.usda",
        """#usda 1.0
def Xform "a" (clips = {
    dictionary default = {
        asset[] assetPaths = [@/etc/hostname@]
        string primPath = "/a"
        double2[] active = [(0, 0)]
        double2[] times = [(0, 0)]
    }
}) {
"""
        + SQUARE
        + "}\n",
    )
    bench.refuses_with('object.0.mesh="clips.usda"', says=("clips.usda", "/etc/hostname"))
