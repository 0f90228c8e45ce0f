# SPDX-License-Identifier: Apache-2.0
"""Run by Blender 5 or by a Python that has bpy: an EXR of layers, read and written again as 32-bit floats.

    blender -b --factory-startup --python benchmarks/peers/blender_reads.py -- LAYERS FOLDER WIDTH HEIGHT

What the image node of the compositor gives goes into FOLDER/read.exr, one layer for each of its sockets, without any
arithmetic; their names and kinds are printed as JSON.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import bpy  # Blender's own module


def node_of(scene: Any, path: str) -> Any:
    """Return an image node of an EXR file, in a new compositor of a scene."""
    tree = bpy.data.node_groups.new("read", "CompositorNodeTree")
    scene.compositing_node_group = tree
    node = tree.nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(path)
    return node


def write(scene: Any, node: Any, folder: str) -> None:
    """Write what the sockets of a node give, as one multi-layer EXR."""
    tree = scene.compositing_node_group
    out = tree.nodes.new("CompositorNodeOutputFile")
    out.directory, out.file_name = folder, "read"
    out.format.media_type = "MULTI_LAYER_IMAGE"
    out.format.file_format, out.format.color_depth = "OPEN_EXR_MULTILAYER", "32"
    for socket in node.outputs:
        out.file_output_items.new({"VALUE": "FLOAT"}.get(socket.type, socket.type), socket.name)
    for given, taken in zip(node.outputs, out.inputs):  # noqa: B905 - one input is left over, for a new item
        tree.links.new(given, taken)
    bpy.ops.render.render()


def main() -> None:
    """Read the arguments behind "--", write the file, print the sockets."""
    path, folder, width, height = sys.argv[sys.argv.index("--") + 1 :]
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "BLENDER_WORKBENCH"  # draws the empty scene beside the compositor
    scene.render.resolution_x, scene.render.resolution_y = int(width), int(height)
    scene.render.resolution_percentage = 100
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    node = node_of(scene, path)
    write(scene, node, folder)
    print("READ", json.dumps([bpy.app.version_string, {s.name: s.type for s in node.outputs}]))


main()
