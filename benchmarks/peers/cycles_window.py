# SPDX-License-Identifier: Apache-2.0
"""Draws a scene of triangles, a sky and a sun with Blender's Cycles; needs the package bpy and nothing of ours.

    python cycles_window.py SCENE.npz FOLDER PATHS [PATHS ...]

PATHS: paths of a pixel; 4d: four, then denoised by Intel's OpenImageDenoise with albedo and normals. Writes
FOLDER/PATHS.exr, linear light, and prints a line for each: PATHS, processor time [s] of drawing alone. The first of
either kind is drawn twice and timed the second time: kernels, meshes and their trees are kept.
"""

import math
import sys
import time

import bpy
import numpy as np
from mathutils import Matrix, Vector

_FAR_M = 500.0
"""Half of a side [m] of the floor."""


def _turned(points):
    """Return points (..., 3) of a world whose y is up in Blender's, whose z is up."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def _diffuse(name, color):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    shader, out = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Color"].default_value = (*map(float, color), 1.0)
    links.new(shader.outputs[0], out.inputs["Surface"])
    return material


def _add(name, corners, normals, color):
    corners = _turned(corners.reshape(-1, 3))
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners.tolist(), [], np.arange(len(corners)).reshape(-1, 3).tolist())
    if normals is not None:
        mesh.shade_smooth()
        mesh.normals_split_custom_set(_turned(normals.reshape(-1, 3)).tolist())
    mesh.materials.append(_diffuse(name, color))
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))


def _sky(image):
    """Light the world with an equirectangular image (H, W, 3) whose middle looks along -z of ours."""
    height, width, _ = image.shape
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = np.roll(image, -width // 4, axis=1)[::-1]
    picture = bpy.data.images.new("sky", width, height, alpha=False, float_buffer=True)
    picture.colorspace_settings.name = "Linear Rec.709"
    picture.pixels.foreach_set(rgba.ravel())
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = picture
    tree.links.new(node.outputs[0], tree.nodes["Background"].inputs["Color"])


def _sun(direction, irradiance, half_angle):
    light = bpy.data.lights.new("sun", "SUN")
    strength = float(max(irradiance))
    light.energy, light.color, light.angle = strength, [float(v) / strength for v in irradiance], 2.0 * half_angle
    lamp = bpy.data.objects.new("sun", light)
    lamp.rotation_euler = Vector(_turned(direction)).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(lamp)


def _camera(look_at, fov_deg):
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit, camera.angle, camera.clip_start = "HORIZONTAL", math.radians(fov_deg), 1e-3
    placed = bpy.data.objects.new("camera", camera)
    back = -Vector(_turned(look_at)).normalized()
    right = Vector((0.0, 0.0, 1.0)).cross(back).normalized()
    placed.matrix_world = Matrix((right, back.cross(right), back)).transposed().to_4x4()
    bpy.context.scene.collection.objects.link(placed)
    bpy.context.scene.camera = placed


def _settings(size, depth):
    render = bpy.context.scene.render
    render.engine, render.use_persistent_data, render.dither_intensity = "CYCLES", True, 0.0
    render.resolution_x, render.resolution_y, render.resolution_percentage = *map(int, size), 100
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    cycles = bpy.context.scene.cycles
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    cycles.max_bounces = cycles.diffuse_bounces = depth
    cycles.sample_clamp_indirect = 0.0


def main(source, folder, *counts):
    """Draw the scene of a file with each of some numbers of paths."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with np.load(source) as given:
        bodies = int(given["bodies"])
        for k in range(bodies):
            _add(f"body{k}", given[f"corners{k}"], given[f"normals{k}"], given[f"color{k}"])
        x, y = _FAR_M, float(given["floor_y"])
        square = np.array([[-x, y, -x], [-x, y, x], [x, y, x], [-x, y, -x], [x, y, x], [x, y, -x]])
        _add("floor", square, None, given["floor_albedo"])
        _sky(given["sky"])
        _sun(given["sun_direction"], given["sun_irradiance"], float(given["sun_half_angle"]))
        _camera(given["look_at"], float(given["fov_deg"]))
        _settings(given["window"], int(given["depth"]))
    scene = bpy.context.scene
    kinds = set()
    for number, paths in enumerate(counts):
        scene.cycles.samples, scene.cycles.seed = int(paths.rstrip("d")), number
        scene.cycles.use_denoising = paths.endswith("d")
        scene.render.filepath = f"{folder}/{paths}.exr"
        first = scene.cycles.use_denoising not in kinds
        kinds.add(scene.cycles.use_denoising)
        for _ in range(2 if first else 1):
            began = time.process_time()
            bpy.ops.render.render(write_still=True)
            took = time.process_time() - began
        print("TIME", paths, took, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
