# SPDX-License-Identifier: Apache-2.0
"""A small whale mesh, lofted from a few profiles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mr360uw.files import write_whole
from mr360uw.types import Floats

_STATIONS, _SIDES = 64, 40
"""Cross sections along the body, and vertices around each."""

# Half height, half width and height of the axis along the body from nose (0) to the root of the fluke (1), in lengths.
_ALONG = np.array([0.0, 0.04, 0.12, 0.25, 0.40, 0.55, 0.70, 0.85, 0.95, 1.0])
_HEIGHT = np.array([0.004, 0.035, 0.068, 0.094, 0.100, 0.085, 0.058, 0.032, 0.018, 0.010])
_WIDTH = np.array([0.004, 0.038, 0.070, 0.088, 0.092, 0.076, 0.048, 0.024, 0.012, 0.012])
_AXIS = np.array([-0.010, -0.008, -0.002, 0.004, 0.006, 0.004, 0.002, 0.004, 0.010, 0.012])

_BACK, _BELLY, _FIN = (0.16, 0.19, 0.22), (0.62, 0.63, 0.60), (0.22, 0.25, 0.28)


def _body() -> tuple[Floats, np.ndarray, Floats]:
    """Return (vertices, faces, colours) of the body, nose towards -z, one length long."""
    from scipy.interpolate import PchipInterpolator

    # stations crowd at the nose, where the outline turns fastest
    s = (1.0 - np.cos(np.linspace(0.0, np.pi, _STATIONS))) / 2.0
    height, width, axis = (PchipInterpolator(_ALONG, y)(s)[:, None] for y in (_HEIGHT, _WIDTH, _AXIS))
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    x = width * np.cos(angle)
    y = axis + height * np.sin(angle)
    z = np.broadcast_to(s[:, None] - 0.5, x.shape)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(_STATIONS - 1), np.arange(_SIDES), indexing="ij")
    a, b = i * _SIDES + j, i * _SIDES + (j + 1) % _SIDES
    c, d = a + _SIDES, b + _SIDES
    faces = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    # counter-shaded like the living animal: dark from above, pale from below
    pale = 1.0 / (1.0 + np.exp(10.0 * (np.sin(angle) + 0.45)))[None, :] * np.clip(1.6 - 1.2 * s, 0.0, 1.0)[:, None]
    colours = np.array(_BACK) * (1.0 - pale[..., None]) + np.array(_BELLY) * pale[..., None]
    return vertices, faces, colours.reshape(-1, 3)


def _fin(root: Floats, tip: Floats, chord: Floats, thickness: float) -> tuple[Floats, np.ndarray, Floats]:
    """Return a flat tapering fin from `root` to `tip` whose chord vector at the root is `chord`."""
    span = np.linspace(0.0, 1.0, 12)[:, None]
    section = np.linspace(0.0, 1.0, 7)
    spine = root + (tip - root) * span + 0.35 * chord * span**2
    taper = np.sqrt(1.0 - 0.96 * span**2)
    normal = np.cross(tip - root, chord)
    normal = normal / np.linalg.norm(normal)
    profile = thickness * np.sqrt(section * (1.0 - section))
    sides = []
    for sign in (1.0, -1.0):
        points = (
            spine[:, None] + chord * (taper * (section - 0.5))[..., None] + sign * normal * (taper * profile)[..., None]
        )
        sides.append(points.reshape(-1, 3))
    rows, columns = len(span), len(section)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (i * columns + j).ravel()
    upper = np.concatenate([np.stack([a, a + 1, a + columns + 1], -1), np.stack([a, a + columns + 1, a + columns], -1)])
    faces = np.concatenate([upper, upper[:, ::-1] + rows * columns])
    vertices = np.concatenate(sides)
    return vertices, faces, np.broadcast_to(_FIN, vertices.shape)


def write_whale(path: Path, length_m: float = 4.0) -> None:
    """Write a whale of `length_m` as binary glTF: metres, nose towards -z, back up, vertex colours."""
    import trimesh

    fins = [
        (
            np.array([sign * 0.07, -0.03, -0.18]),
            np.array([sign * 0.30, -0.09, -0.08]),
            np.array([0.0, 0.0, 0.085]),
            0.012,
        )
        for sign in (1.0, -1.0)
    ]
    fins += [
        (np.array([0.0, 0.012, 0.49]), np.array([sign * 0.17, 0.02, 0.53]), np.array([0.0, 0.0, 0.09]), 0.010)
        for sign in (1.0, -1.0)
    ]
    fins.append((np.array([0.0, 0.085, 0.14]), np.array([0.0, 0.14, 0.20]), np.array([0.0, 0.0, 0.08]), 0.010))
    vertices, faces, colours, offset = [], [], [], 0
    for part in (_body(), *(_fin(*fin) for fin in fins)):
        vertices.append(part[0])
        faces.append(part[1] + offset)
        colours.append(part[2])
        offset += len(part[0])
    mesh = trimesh.Trimesh(np.concatenate(vertices) * length_m, np.concatenate(faces), process=False)
    mesh.fix_normals()
    rgba = np.concatenate([np.concatenate(colours), np.ones((offset, 1))], axis=1)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.round(255 * rgba).astype(np.uint8))
    write_whole(path, trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh)))
