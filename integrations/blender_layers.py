# SPDX-License-Identifier: Apache-2.0
"""Builds the compositor of a Blender scene that lays the layers of mr360uw over their plate. Blender 5.0 or later.

    blender --background --python blender_layers.py -- dive.mp4 layers_%04d.exr 0 240 over_

renders frames 0 to 240 into over_0000.exr and so on. In Blender: import blender_layers, then
blender_layers.build(bpy, "dive.mp4", "layers_%04d.exr", 0, 240); frames of the scene are those of the layers.

composite = rgb + (1 - A) (plate + receiver_difference)
rgb = diffuse + glossy + sun + lamps + emission + veil + shafts + snow
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

PARTS = ("diffuse", "glossy", "sun", "lamps", "emission", "veil", "shafts", "snow")
"""Parts of the light of objects that add up to the colour of the layer."""


def build(bpy: Any, plate: str, layers: str, first: int, last: int) -> Any:
    """Return the node group of the composite of frames first .. last, which becomes that of the open scene.

    plate: a movie, or the first picture of a sequence numbered as the layers are.
    """
    scene = bpy.context.scene
    tree = bpy.data.node_groups.new("mr360uw", "CompositorNodeTree")
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    # Open the plate, whose movie frames count from 1, and the layers
    behind, read = tree.nodes.new("CompositorNodeImage"), tree.nodes.new("CompositorNodeImage")
    for node, path in ((behind, plate), (read, layers % first)):
        node.image = bpy.data.images.load(str(Path(path).absolute()))
        movie = node.image.source == "MOVIE"
        node.image.source = "MOVIE" if movie else "SEQUENCE"
        node.frame_start, node.frame_duration, node.frame_offset = first, last - first + 1, first - (not movie)
    scene.render.resolution_x, scene.render.resolution_y = behind.image.size
    scene.render.resolution_percentage = 100
    scene.frame_start, scene.frame_end = first, last
    # Darken or light the ground, and lay over it the sum of the parts, each to be graded
    ground = _sum(tree, behind.outputs["Image"], read.outputs["receiver_difference"])
    light = read.outputs[PARTS[0]]
    for name in PARTS[1:]:
        light = _sum(tree, light, read.outputs[name])
    alpha, covered = tree.nodes.new("CompositorNodeSeparateColor"), tree.nodes.new("CompositorNodeSetAlpha")
    tree.links.new(read.outputs["rgba"], alpha.inputs[0])
    tree.links.new(light, covered.inputs["Image"])
    tree.links.new(alpha.outputs["Alpha"], covered.inputs["Alpha"])
    covered.inputs["Type"].default_value = "Replace Alpha"
    over, out = tree.nodes.new("CompositorNodeAlphaOver"), tree.nodes.new("NodeGroupOutput")
    tree.links.new(ground, over.inputs["Background"])
    tree.links.new(covered.outputs[0], over.inputs["Foreground"])
    tree.links.new(over.outputs[0], out.inputs[0])
    scene.compositing_node_group = tree
    scene.render.use_compositing = True
    return tree


def _sum(tree: Any, one: Any, other: Any) -> Any:
    """Return the socket of the sum of two colours."""
    node = tree.nodes.new("ShaderNodeMix")
    node.data_type, node.blend_type, node.inputs[0].default_value = "RGBA", "ADD", 1.0
    colours = [socket for socket in node.inputs if socket.type == "RGBA"]
    tree.links.new(one, colours[0])
    tree.links.new(other, colours[1])
    return next(socket for socket in node.outputs if socket.type == "RGBA")


def render(bpy: Any, name: str) -> None:
    """Write the composite of the scene's frames as EXR files, linear; the scene itself is not rendered."""
    settings = bpy.context.scene.render
    settings.engine, settings.filepath, settings.use_file_extension = "CYCLES", str(Path(name).absolute()), True
    settings.image_settings.file_format, settings.image_settings.color_depth = "OPEN_EXR", "32"
    bpy.ops.render.render(animation=True)


if __name__ == "__main__":
    import bpy

    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    if len(given) != 5:
        raise SystemExit("usage: blender --background --python blender_layers.py -- PLATE LAYERS FIRST LAST OUT")
    build(bpy, given[0], given[1], int(given[2]), int(given[3]))
    render(bpy, given[4])
