# SPDX-License-Identifier: Apache-2.0
"""Textured meshes near a bright floor against path tracing: python benchmarks/textured_dives.py MESH ... [--paths N]

The meshes take turns in six dives of tests/lit_dives.py, matt, with their own textures, afloat and standing. Printed
are means over regions: light of the composite over that of the truth, the difference in 8-bit codes of a picture whose
floor is at 60 % of white, and the noise of the truth; last, how many are off by more than 5 % and more than two codes.
Some 20 s of a core for a dive. MESH: files that trimesh reads, with one texture or none.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import trimesh
from PIL import Image
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.dive_truth import channel, hit_mesh, means
from mr360uw.base.color import decode, encode
from tests.lit_dives import DIVES, SIZE, LitDive, composed, half_pixel_rays, plate_of, whole_pixels

PLACES: dict[str, tuple[tuple[float, float, float], float, float, bool]] = {
    "sand": ((-0.5, -0.5, -0.9), 0.8, 40.0, False),
    "white": ((-0.3, -0.5, -1.0), 0.9, 120.0, True),
    "deep": ((0.6, -0.45, -0.9), 0.8, 20.0, False),
    "near": ((0.5, -0.5, -1.1), 0.9, -60.0, True),
    "green": ((0.4, -0.5, 0.9), 0.8, 200.0, False),
    "dark": ((-0.4, -0.5, -1.0), 0.8, 0.0, True),
}
"""Of each dive the mesh's middle and size, in heights of the camera over the floor, its yaw, and whether it stands."""
LEAF, FLOOR_SHOWN, PLAIN = 4, 0.6, (188, 170, 150)
"""Triangles of a leaf of the tree at most, what bright floor is shown as, and codes of a mesh without a texture."""
AWAY = np.array([0.0, 1e9, 0.0, 1e-3, 0.0]), np.array([0.0, 1e9, 0.0, 1e-3, 1e-3, 1e-3, 1.0, 0.0, 0.0])
"""The ball and the box of the dives, out of the way."""


class Posed(NamedTuple):
    """A mesh in its place, as of `hit_mesh`; its texture (h, w, 3), linear; its middle, and half its width."""

    nodes: np.ndarray
    triangles: np.ndarray
    normal: np.ndarray
    uv: np.ndarray
    texture: np.ndarray
    middle: np.ndarray
    wide: float

    def in_channel(self, k: int) -> tuple[np.ndarray, ...]:
        """Return what `means` asks of it in a channel."""
        return (*self[:4], np.ascontiguousarray(self.texture[..., k]))


def tree(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes of a tree of boxes, and the order of the triangles in it."""
    low, high, order = triangles.min(axis=1), triangles.max(axis=1), np.arange(len(triangles))
    middle, nodes = 0.5 * (low + high), []

    def build(first: int, end: int) -> int:
        some, number = order[first:end], len(nodes)
        nodes.append([*low[some].min(axis=0), *high[some].max(axis=0), first, end - first])
        if end - first > LEAF:
            axis, half = np.ptp(middle[some], axis=0).argmax(), (end - first) // 2
            order[first:end] = some[np.argpartition(middle[some, axis], half)]
            build(first, first + half)
            nodes[number][6:] = [build(first + half, end), 0]
        return number

    build(0, len(triangles))
    return np.array(nodes, np.float64), order


def posed(path: Path, name: str, out: Path) -> Posed:
    """Return a mesh in its place in a dive, and write it so as a matt glTF file."""
    (x, y, z), size, yaw_deg, stands = PLACES[name]
    mesh, height = trimesh.load(path, force="mesh", process=False), DIVES[name].height_m
    uv, material = getattr(mesh.visual, "uv", None), getattr(mesh.visual, "material", None)
    uv = np.zeros((len(mesh.vertices), 2)) if uv is None else np.asarray(uv)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    image = (image or Image.new("RGB", (2, 2), PLAIN)).convert("RGB")
    # Turn it, scale it, and put its middle where it is to be
    low, high = mesh.bounds
    scale = size * height / np.max(high - low)
    turn = trimesh.transformations.rotation_matrix(np.radians(yaw_deg), [0.0, 1.0, 0.0])[:3, :3]
    at_y = 0.5 * (high - low)[1] * scale - height + 1e-4 if stands else y * height
    middle = np.array([x * height, at_y, z * height])
    places = ((mesh.vertices - 0.5 * (low + high)) * scale) @ turn.T + middle
    # Lay out its triangles as the tree has them, each with vertices of its own: flat, as the paths see it
    nodes, order = tree(places[mesh.faces])
    triangles, uv = np.ascontiguousarray(places[mesh.faces[order]]), np.ascontiguousarray(uv[mesh.faces[order]])
    matt = trimesh.visual.material.PBRMaterial(baseColorTexture=image, metallicFactor=0.0, roughnessFactor=1.0)
    visual = trimesh.visual.TextureVisuals(uv=uv.reshape(-1, 2), material=matt)
    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    trimesh.Trimesh(triangles.reshape(-1, 3), corners, process=False, visual=visual).export(out)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    texture = decode(np.asarray(image, np.float64) / 255.0, "srgb")
    wide = 0.5 * float(np.max((high - low)[[0, 2]])) * scale
    return Posed(nodes, triangles, normal, uv, texture, middle, wide)


@numba.njit
def cast(o, d, mesh, reach, who):
    """Set the distance (n,) to what rays meet first of a mesh, and its triangle (n,)."""
    for k in range(len(o)):
        reach[k], who[k], _, _ = hit_mesh(o[k], d[k], mesh, False)


def seen(o: np.ndarray, d: np.ndarray, mesh: Posed, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return kind (0 water, 1 floor, 2 mesh), point and normal (..., 3) that rays see first."""
    start, ray = (np.ascontiguousarray(np.broadcast_to(v, d.shape).reshape(-1, 3), np.float64) for v in (o, d))
    reach, who = np.empty(len(ray)), np.empty(len(ray), np.int64)
    cast(start, ray, mesh.in_channel(0), reach, who)
    with np.errstate(divide="ignore"):
        to_floor = np.where(ray[:, 1] < 0.0, (-height - start[:, 1]) / ray[:, 1], 1e9)
    kind = np.where(reach < to_floor, 2, np.where(to_floor < 1e9, 1, 0))
    normal = np.where((kind == 2)[:, None], mesh.normal[np.maximum(who, 0)], [0.0, 1.0, 0.0])
    normal = np.where(np.sum(normal * ray, axis=1, keepdims=True) > 0.0, -normal, normal)
    point = start + np.minimum(reach, to_floor)[:, None] * ray
    return kind.reshape(d.shape[:-1]), point.reshape(d.shape), normal.reshape(d.shape)


def regions_of(dive: LitDive, mesh: Posed) -> dict[str, np.ndarray]:
    """Return masks (H, W) of the pixels that lie wholly in a region."""
    d, h = half_pixel_rays(), dive.height_m
    kind, point, normal = seen(np.zeros(3), d, mesh, h)
    body, floor, facing, up = kind == 2, kind == 1, normal @ dive.sun, normal[..., 1]
    floor &= np.linalg.norm(point, axis=-1) < 5.0 * h

    def shaded(aside: np.ndarray) -> np.ndarray:
        return seen(point + 1e-5 * normal + h * aside, np.broadcast_to(dive.sun, d.shape), mesh, h)[0] == 2

    sides = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    unlit, dark = shaded(np.zeros(3)), [shaded(0.02 * side) for side in sides]
    edge = np.logical_or.reduce([shaded(0.04 * side) for side in sides])
    # How far floor is from the mesh, and from its middle
    away = np.hypot(point[..., 0] - mesh.middle[0], point[..., 2] - mesh.middle[2]) / mesh.wide
    gap, near = np.full(kind.shape, np.inf), floor & (away < 2.0)
    gap[near] = cKDTree(mesh.triangles.reshape(-1, 3)).query(point[near])[0]
    found = {
        "body": body, "lit": body & (facing > 0.3), "side, lit": body & (np.abs(up) < 0.5) & (facing > 0.1),
        "side, away": body & (np.abs(up) < 0.5) & (facing < -0.1), "below": body & (up < -0.5),
        "top": body & (up > 0.5),
        "umbra": floor & unlit & np.logical_and.reduce(dark), "contact": floor & (gap < 0.08 * h),
        "beside": floor & ~unlit & ~edge & (away > 1.0) & (away < 1.6),
    }  # fmt: skip
    return whole_pixels(found)


def compare(name: str, path: Path, paths: int, seed: int) -> np.ndarray:
    """Print the rows of a dive with a mesh; return which of their values (n, 3) are off."""
    dive, off = DIVES[name], []
    with tempfile.TemporaryDirectory() as folder:
        mesh = posed(path, name, Path(folder) / "posed.glb")
        matt = {"mesh": "posed.glb", "position_m": [0.0, 0.0, 0.0], "refractive_index": dive.refractive_index}
        image = composed(name, "gl", Path(folder), object=[matt]).image_linear.astype(np.float64)
    exposure = FLOOR_SHOWN / np.percentile(plate_of(name)[..., 1], 95.0)
    print(f"{name}, {path.name}, {'standing' if PLACES[name][3] else 'afloat'}")
    for number, (region, mask) in enumerate(regions_of(dive, mesh).items()):
        # Trace its pixels in each channel
        some = np.argwhere(mask)
        each, truth, noise = -(-paths // len(some)), np.zeros(3), np.zeros(3)
        for k in range(3):
            of, place = channel(dive, k)[:5], 1000 * seed + 10 * number + k
            found = means(some, SIZE, each, place, *of, *AWAY, mesh.in_channel(k), True)
            truth[k], noise[k] = found[:, 0].mean(), np.sqrt(np.sum(found[:, 1] ** 2)) / len(some)
        # Compare light and codes
        light = image[mask].mean(axis=0)
        codes = 255.0 * (encode(exposure * light, "srgb") - encode(exposure * truth, "srgb"))
        off.append((np.abs(light / truth - 1.0) > 0.05) & (np.abs(codes) > 2.0))
        ratios, steps = ("  ".join(f"{x:{form}}" for x in of) for of, form in ((light / truth, ".3f"), (codes, "+.1f")))
        print(f"  {region:12s} {ratios}   codes {steps}   noise {np.max(noise / truth):.3f}", flush=True)
    return np.array(off)


def main() -> None:
    """Compare all dives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", type=Path, nargs="+", metavar="MESH")
    parser.add_argument("--paths", type=int, default=400_000, help="for a region and a channel")
    asked = parser.parse_args()
    pairs = zip(PLACES, cycle(asked.meshes))
    off = np.concatenate([compare(name, path, asked.paths, seed) for seed, (name, path) in enumerate(pairs)])
    print(f"{np.count_nonzero(off)} of {off.size} means are off by more than 5 % and two codes")


if __name__ == "__main__":
    main()
