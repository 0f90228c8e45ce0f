# SPDX-License-Identifier: Apache-2.0
"""Builds the tree in Nuke that lays the layers of mr360uw over their plate, each part with a grade of its own.

import nuke_mr360uw
nuke_mr360uw.build("dive.mp4", "layers_%04d.exr", first=0, last=240)

composite = rgb + (1 - A) (plate + receiver_difference)
rgb = diffuse + glossy + sun + lamps + emission + veil + shafts + snow
"""

from __future__ import annotations

from typing import Any

PARTS = ("diffuse", "glossy", "sun", "lamps", "emission", "veil", "shafts", "snow")
"""Parts of the light of objects that add up to the colour of the layer."""


def build(plate: str, layers: str, first: int, last: int) -> Any:
    """Return the node that holds the composite of the frames first .. last."""
    import nuke

    behind = nuke.nodes.Read(file=plate, first=first, last=last, colorspace="sRGB", name="mr360uw_plate")
    read = nuke.nodes.Read(file=layers, first=first, last=last, colorspace="linear", name="mr360uw_layers")
    ground = _part(nuke, read, "receiver_difference")
    shaded = nuke.nodes.Merge2(inputs=[behind, ground], operation="plus", name="mr360uw_ground")
    light = None
    for name in PARTS:
        graded = nuke.nodes.Grade(inputs=[_part(nuke, read, name)], name=f"mr360uw_grade_{name}")
        light = graded if light is None else nuke.nodes.Merge2(inputs=[light, graded], operation="plus")
    covered = nuke.nodes.Copy(inputs=[light, read], from0="rgba.alpha", to0="rgba.alpha", name="mr360uw_covered")
    return nuke.nodes.Merge2(inputs=[shaded, covered], operation="over", name="mr360uw_composite")


def _part(nuke: Any, read: Any, name: str) -> Any:
    """Return a part of the layers as red, green and blue."""
    return nuke.nodes.Shuffle(inputs=[read], **{"in": name}, name=f"mr360uw_{name}")
