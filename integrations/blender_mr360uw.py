# SPDX-License-Identifier: Apache-2.0
"""Writes the objects of a Blender scene as a scene of mr360uw. Runs inside Blender 4.2 or later.

    blender --background reef.blend --python blender_mr360uw.py -- dive.mp4 reef_scene

The folder gets a glTF file for each object without a parent (with all that hangs on it) and `scene.toml`. Seen from the
scene's camera: its place is that of the 360 camera, its horizontal direction that of the middle of the plate. The first
frame of Blender's range is time 0. Motion of objects becomes ten keys a second; skins and shape keys stay in the glTF.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

KEYS_PER_S = 10.0


def angles(rotation: Any) -> tuple[float, float, float]:
    """Return (yaw, pitch, roll) [deg] of a rotation matrix, three rows, of a body that looks along -z with +y up."""
    forward = [-row[2] for row in rotation]
    pitch = math.asin(max(-1.0, min(1.0, forward[1])))
    if abs(forward[1]) > 1.0 - 1e-9:  # straight up or down: yaw and roll are one angle
        return math.degrees(math.atan2(rotation[2][0], rotation[0][0])), math.degrees(pitch), 0.0
    yaw, roll = math.atan2(forward[0], -forward[2]), math.atan2(-rotation[1][0], rotation[1][1])
    return math.degrees(yaw), math.degrees(pitch), math.degrees(roll)


def pose(matrix: Any, camera: Any) -> tuple[list[float], list[float]]:
    """Return position [m] and (yaw, pitch, roll) [deg] of a Blender world matrix, seen from a camera's."""
    ahead = [-camera[0][2], -camera[1][2]]
    length = math.hypot(*ahead)
    if length < 1e-6:
        raise SystemExit("the camera looks straight up or down - turn it to the direction of the plate's middle")
    x, y = ahead[0] / length, ahead[1] / length
    # rows: right, up and back of the plate, in Blender's axes (z up)
    axes = ((y, -x, 0.0), (0.0, 0.0, 1.0), (-x, -y, 0.0))
    offset = [matrix[k][3] - camera[k][3] for k in range(3)]
    size = [math.sqrt(sum(matrix[k][n] ** 2 for k in range(3))) for n in range(3)]
    turned = [[sum(axes[i][k] * matrix[k][n] / size[n] for k in range(3)) for n in range(3)] for i in range(3)]
    # glTF has y up: its axes are Blender's x, z, -y
    rotation = [[row[0], row[2], -row[1]] for row in turned]
    position = [sum(axis[k] * offset[k] for k in range(3)) for axis in axes]
    return [round(v, 5) for v in position], [round(v, 4) for v in angles(rotation)]


def toml_of(plate: str, placed: list[tuple[str, list[tuple[float, list[float], list[float]]]]]) -> str:
    """Return the scene file of a plate and of mesh files with poses over time."""
    lines = ["# Written from Blender.", "[plate]", f'path = "{plate}"', "", "[camera]", "depth_m = 5.0", ""]
    for mesh, poses in placed:
        _, position, rotation = poses[0]
        lines += ["[[object]]", f'mesh = "{mesh}"', f"position_m = {position}", f"rotation_deg = {rotation}"]
        if any(one[1:] != poses[0][1:] for one in poses):
            lines += ["key = ["]
            lines += [f"  {{ time_s = {t:.4f}, position_m = {p}, rotation_deg = {r} }}," for t, p, r in poses]
            lines += ["]"]
        lines.append("")
    return "\n".join(lines)


def export(bpy: Any, plate: str, folder: Path) -> Path:
    """Write the scene that is open in Blender; return the scene file."""
    scene = bpy.context.scene
    if scene.camera is None:
        raise SystemExit("the scene has no camera - add one where the 360 camera was, looking at the plate's middle")
    roots = [one for one in scene.objects if one.parent is None and any(_meshes(one))]
    if not roots:
        raise SystemExit("the scene has no visible mesh - show what is to be put into the video")
    folder.mkdir(parents=True, exist_ok=True)
    rate = scene.render.fps / scene.render.fps_base
    step = max(1, round(rate / KEYS_PER_S))
    frames = [*range(scene.frame_start, scene.frame_end, step), scene.frame_end]
    tracks: dict[str, list[tuple[float, list[float], list[float]]]] = {root.name: [] for root in roots}
    for frame in frames:
        scene.frame_set(frame)
        for root in roots:
            found = pose(root.matrix_world, scene.camera.matrix_world)
            tracks[root.name].append(((frame - scene.frame_start) / rate, *found))
    scene.frame_set(scene.frame_start)
    placed = []
    for root in roots:
        file = folder / f"{''.join(c if c.isalnum() else '_' for c in root.name)}.glb"
        _write_mesh(bpy, root, file)
        placed.append((file.name, tracks[root.name]))
    made = folder / "scene.toml"
    made.write_text(toml_of(Path(plate).absolute().as_posix(), placed), "utf-8")
    return made


def _meshes(root: Any) -> list[Any]:
    return [one for one in (root, *root.children_recursive) if one.type == "MESH" and not one.hide_render]


def _write_mesh(bpy: Any, root: Any, file: Path) -> None:
    """Export an object and what hangs on it as glTF, at the origin and unturned; its size stays."""
    action = root.animation_data.action if root.animation_data else None
    before = root.matrix_world.copy()
    if action is not None:
        root.animation_data.action = None
    root.matrix_world = type(before).Diagonal((*before.to_scale(), 1.0))
    bpy.context.view_layer.update()
    bpy.ops.object.select_all(action="DESELECT")
    for one in (root, *root.children_recursive):
        one.select_set(True)
    bpy.ops.export_scene.gltf(filepath=str(file), export_format="GLB", use_selection=True, export_apply=False)
    root.matrix_world = before
    if action is not None:
        root.animation_data.action = action


if __name__ == "__main__":
    import bpy

    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    if len(given) != 2:
        raise SystemExit("usage: blender --background FILE.blend --python blender_mr360uw.py -- PLATE FOLDER")
    sys.stdout.write(f"wrote {export(bpy, given[0], Path(given[1]))}\n")
