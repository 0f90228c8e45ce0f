# SPDX-License-Identifier: Apache-2.0
"""Objects on OpenGL 3.3: shading of the visible fragments, and their sum in pixels.

Fragments are shaded as a list, one texel each (layer.frag), so pixels with few do not wait for pixels with many.
Objects that share a mesh are shaded together.

Where several small triangles meet in a pixel, each is a fragment of a few samples. Groups are neighbours on a body's
surface in one pixel, which share what they see of the sun. Shadow rays are cast once for all of them: from the fragment
with most samples, over the area of the group. Fragments that face away from the sun get none.

Most of a body sees all of the sun, or nothing of it. So rays are cast from every second pixel along rows and columns
first; a pixel between others of the same surface that all see the whole sun, or none, sees the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf, Same, Scratch
from mr360uw.composite.ambient.mesh_transfer import FEW_CHANNELS, UNTOUCHED, Lattice
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.aovs import SUMS, AovFrame
from mr360uw.composite.gl.device import (
    Places,
    ShadingInputs,
    Targets,
    list_texture,
    upload_mesh,
    upload_still,
)
from mr360uw.composite.gl.light_visibility import DISC, HALF_OF_RAYS, HALO, Visibility, footprints_of
from mr360uw.composite.gl.visible_surfaces import Fragments, Surfaces, find_surfaces
from mr360uw.composite.light_sources import sun_of
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.sampling import filter_width, root_of_moments
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.jit import exact, exact_making
from mr360uw.types import Floats, Tile

if TYPE_CHECKING:
    import moderngl


_CHANNELS = ((4, 1), (4,) * 6, (4,) * 4)
"""Outputs of layer.frag: radiance and distance, both halves of the output variables."""
_PARTS = 256
"""Groups of fragments of one mesh in one layer, of which it is kept what they see of the sun."""
_KEPT = 1 << 21
"""Most fragments, about 100 bytes each, kept between frames."""
_KEPT_MESHES = 64
"""Meshes on the device. Poses are kept as many as the shot has: the next one has others."""


Bodies = tuple["moderngl.Texture", dict[Mesh, Places]]
"""Texture of bodies, four texels each as layer.frag says, then values of ambient light at points; and those points of
the meshes that have any."""
_Lit = tuple[Shot, ShadingInputs, Surfaces]
"""A shot, its light on the device, and the visible surfaces of its objects."""


class ObjectPass:
    """Draws and shades the objects of shots; caches meshes, and the fragments while objects and camera are at rest."""

    def __init__(self, targets: Targets, cache: Cache) -> None:
        self._targets, self._cache, self._scratch = targets, cache, Scratch()

    def find(self, shot: Shot) -> Surfaces:
        """Return the visible surfaces of a shot's objects."""
        sampled = PartOf(shot, shot.view, shot.draw.samples, shot.draw.shading)
        surfaces = self._cache.of(find_surfaces, sampled, list(shot.visible), self._cache)
        if sum(len(layer.triangle) for layer in surfaces.layers) > _KEPT:
            self._cache.drop(find_surfaces)
        return surfaces

    def draw(self, lit: _Lit, tiles: Sequence[Tile], frame: AovFrame | None, ambient: AmbientLight | None) -> None:
        """Composite the surfaces of a shot behind the contents of tiles.

        frame: receives output variables, or None. ambient: solved ambient light among the bodies.
        """
        # List the bodies on the device, then shade layer by layer, the nearest first
        shot, _, surfaces = lit
        objects, layers = shot.visible, surfaces.layers
        listed, changed = self._body_list(shot, objects, ambient)
        bodies = list_texture(*listed, scratch=self._scratch), changed
        for number, fragments in enumerate(layers):
            if len(fragments.triangle) == 0:
                continue
            layer = PartOf((objects, surfaces.first, fragments), Same(fragments))
            parts = surfaces.cache.of(mesh_fragments, layer, keep=len(layers))
            blended = number < len(layers) - 1
            values_of = self._light_up(lit, parts, len(fragments.triangle), bodies, blended, 0)
            # The output variables count by what shows through the layers before
            if frame is not None:
                halves = [self._light_up(lit, parts, len(fragments.triangle), bodies, blended, k) for k in (1, 2)]
                seen = through(tiles, fragments)[fragments.pixel()] * fragments.weight * values_of[:, 3]
                of_names = np.concatenate(halves, axis=1)
                values = {name: of_names[:, 4 * k : 4 * k + 3] for k, name in enumerate(SUMS)}
                pixel = fragments.pixel()
                frame.add((fragments.row[pixel], fragments.column[pixel]), seen, values, fragments.triangle)
            pieces = fragments.row, fragments.column, fragments.first, fragments.weight
            for tile in tiles:
                sum_behind(pieces, values_of, (tile.row, tile.column), (tile.radiance, tile.alpha, tile.distance_m))

    def _body_list(
        self, shot: Shot, objects: Sequence[PlacedObject], ambient: AmbientLight | None
    ) -> tuple[list[NDArray[np.float32]], dict[Mesh, Places]]:
        """Return where bodies are, and the values of ambient light on them, as `Bodies` has them."""
        table = np.zeros((len(objects), 4, 4), np.float32)
        values, texels = [table], 4 * len(objects)
        # Of a mesh that has any values on one of its bodies all have some
        of_bodies: dict[PlacedObject, tuple[Lattice, Any]] = {}
        changed: dict[Mesh, Places] = {}
        if ambient is not None:
            for placed, of, known in zip(shot.objects, ambient.layout.bodies, ambient.values, strict=False):
                of_bodies[placed] = of.transfer.lattice, known
                if placed.visible and known is not None:  # places count by identity: to read them takes a millisecond
                    changed[placed.mesh] = PartOf(of.transfer.lattice.places, Same(of.transfer.lattice.places))
        for row, placed in zip(table, objects, strict=True):
            row[:3] = placed.world_from_object[:3]
            row[:3, 3] -= shot.view.position
            if placed.mesh not in changed:
                continue
            lattice, known = of_bodies[placed]
            points = lattice.points * (2 if lattice.two_sided else 1)
            own = np.tile(np.array(UNTOUCHED[:FEW_CHANNELS], np.float32), (points, 1)) if known is None else known
            row[3, 1:4] = texels, lattice.points if lattice.two_sided else 0, own.shape[1] // 4
            values.append(own)
            texels += own.size // 4
        return values, changed

    def _light_up(
        self, lit: _Lit, parts: Sequence[MeshFragments], count: int, bodies: Bodies, blended: bool, outputs: int
    ) -> Floats:
        """Return the outputs (count, channels) of layer.frag for `count` fragments. outputs: see `_CHANNELS`."""
        (shot, light, surfaces), values = lit, np.empty((count, sum(_CHANNELS[outputs])), np.float32)
        uniforms = light.uniforms | {"filter_width": filter_width(shot.draw.samples, shot.draw.shading)}
        for part in parts:
            # Give them the mesh, the bodies' values and the light, and compile what these need, and no more
            mesh, places, still, keep = part.mesh, bodies[1].get(part.mesh), None, _KEPT_MESHES
            if mesh.rest is not None:  # what all of its poses share
                still, places = self._cache.of(upload_still, mesh.still, places, keep=_KEPT_MESHES), None
                keep = len({placed.mesh for placed in shot.objects if placed.mesh.rest is not None})
            of_mesh, defines = self._cache.of(upload_mesh, mesh, places, still, keep=keep)
            defines = {"OUTPUTS": outputs} | defines | light.defines
            defines |= {"BLENDED": 1} if blended else {}
            defines |= {"AMONG_BODIES": 1} if part.mesh in bodies[1] else {}
            textures = {"bodies": bodies[0], **of_mesh, **light.textures}
            textures["fragments"] = surfaces.cache.of(_entries, part, keep=_PARTS)
            # And what they see of the sun and of lamps
            whole, visibility = (shot, light.visibility, surfaces), light.visibility
            if "SHADOW" in light.defines:
                seen = PartOf(whole, visibility.of_sun)
                textures["sun_seen"] = surfaces.cache.of(_see_sun, part, seen, keep=_PARTS)
            if "LAMPS" in light.defines:
                seen = PartOf(whole, visibility.of_lamps)
                textures["lamps_seen"] = surfaces.cache.of(_see_lamps, part, seen, keep=_PARTS)
            shaded = self._targets.shaded("layer", defines, textures, uniforms, len(part.listed), _CHANNELS[outputs])
            values[part.chosen] = shaded
        return values


def _entries(part: MeshFragments) -> moderngl.Texture:
    """Return the texture of triangles, places and bodies of fragments."""
    return list_texture(part.listed[:, :4])


_Seen = PartOf[tuple[Shot, Visibility, Surfaces]]


def _see_sun(part: MeshFragments, seen: _Seen) -> moderngl.Texture:
    """Return the visible fractions of the sun's disc and halo of each fragment, as layer.frag reads them."""
    shot, visibility, surfaces = seen.whole
    sun = sun_of(shot)
    assert sun is not None
    groups = sun_groups(shot, part, surfaces.facets, sun.direction)
    of_groups, asked = np.zeros((len(groups.listed), 2), np.float32), groups.first
    for turn in range(2):
        asked = groups.fill_between(of_groups) if turn else asked
        footprints = _footprints(shot, visibility, groups.listed[asked], groups.surface[asked])
        of_groups[asked] = visibility.seen(footprints, (DISC, HALO), HALF_OF_RAYS)
    fractions = np.ones((len(groups.of), 2), np.float32)
    there = groups.of >= 0
    fractions[there] = of_groups[groups.of[there]]
    return list_texture(fractions, channels=2)


def _see_lamps(part: MeshFragments, seen: _Seen) -> moderngl.Texture:
    """Return the visible fractions of the lamps of each fragment, as layer.frag reads them."""
    shot, visibility, surfaces = seen.whole
    surface = fragment_planes(shot, part, surfaces.facets, np.zeros(3))
    footprints = _footprints(shot, visibility, part.listed, surface[:, :4])
    return list_texture(visibility.seen(footprints, visibility.lamps), channels=1)


def _footprints(shot: Shot, visibility: Visibility, listed: Floats, surface: Floats) -> Floats:
    """Return the footprints (n, 12) of fragments. listed: (n, 9) of `MeshFragments`. surface: (n, 4) unit normal in the
    camera's axes, and distance.
    """
    bias = visibility.bias * np.array([placed.bias_m for placed in shot.visible])[listed[:, 3].astype(np.int64)]
    in_world = np.append(surface[:, :3] @ shot.view.world_from_camera.T, surface[:, 3:], axis=1)
    width = filter_width(shot.draw.samples, shot.draw.shading)
    places, areas = listed[:, 1:3] - 0.5, listed[:, 4:]
    return footprints_of(shot.view, places, areas, (1, 1.0), in_world, bias, width)


@exact
def sum_behind(pieces: Any, values: Any, corner: Any, tile: Any) -> None:
    """Composite the fragments (n,) of pixels (p,) behind a tile.

    pieces: row, column, first and weight of `Fragments`. values: (n, 5) radiance, alpha and distance [m]. corner: row
    and column of the tile; tile: its radiance, alpha and distance. A pixel takes the sum of weight alpha times the
    radiance, and the least distance.
    """
    row, column, first, weight = pieces
    radiance, alpha, distance = tile
    for p in range(len(row)):
        r, c = row[p] - corner[0], column[p] - corner[1]
        if r < 0 or c < 0 or r >= alpha.shape[0] or c >= alpha.shape[1]:
            continue
        red, green, blue, cover, nearest = 0.0, 0.0, 0.0, 0.0, distance[r, c]
        for n in range(first[p], first[p + 1] if p + 1 < len(first) else len(weight)):
            share = weight[n] * values[n, 3]
            red += share * values[n, 0]
            green += share * values[n, 1]
            blue += share * values[n, 2]
            cover += share
            nearest = min(nearest, values[n, 4])
        free = 1.0 - alpha[r, c]
        radiance[r, c, 0] += free * red
        radiance[r, c, 1] += free * green
        radiance[r, c, 2] += free * blue
        alpha[r, c] += free * cover
        distance[r, c] = nearest


def through(tiles: Sequence[Tile], fragments: Fragments) -> Floats:
    """Return the transparency (p,) = 1 - alpha of tiles at the pixels of fragments."""
    free = np.ones(len(fragments.row), np.float32)
    for tile in tiles:
        rows, columns = tile.alpha.shape
        r, c = fragments.row - tile.row, fragments.column - tile.column
        inside = np.flatnonzero((r >= 0) & (r < rows) & (c >= 0) & (c < columns))
        free[inside] = 1.0 - tile.alpha[r[inside], c[inside]]
    return free


_AT_ONCE = 1 << 19
LayerOf = tuple[tuple[PlacedObject, ...], NDArray[np.int64], Fragments]
"""Objects, the number of each one's first triangle, and a layer."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshFragments:
    """Fragments of one mesh that are shaded together. chosen: (n,) numbers among all, or where these are in the list.

    listed: (n, 9) of each, triangle of the mesh, place (2), body and area (5) of `Fragments`. triangle: (n,) numbers
    of triangles among all. pixel: (n,) numbers, those of a pixel in sequence; weight: (n,) of `Fragments`.
    """

    mesh: Mesh
    chosen: NDArray[np.int64] | slice
    listed: Floats
    triangle: NDArray[np.int64]
    pixel: NDArray[np.int64]
    weight: Floats


def mesh_fragments(layer: PartOf[LayerOf]) -> list[MeshFragments]:
    """Return the fragments of a layer by mesh."""
    objects, first, fragments = layer.whole
    body = np.searchsorted(first, fragments.triangle, side="right") - 1
    pixel = fragments.pixel()
    listed = np.empty((len(fragments.triangle), 9), np.float32)
    listed[:, 0] = fragments.triangle - first[body]
    listed[:, 1:3], listed[:, 3], listed[:, 4:] = fragments.place, body, fragments.area
    meshes: dict[Mesh, int] = {}
    of_mesh, parts = np.zeros(len(objects), np.int64), []
    for number, placed in enumerate(objects):
        of_mesh[number] = meshes.setdefault(placed.mesh, len(meshes))
    for mesh, k in meshes.items():
        chosen = np.flatnonzero(of_mesh[body] == k)
        for start in range(0, len(chosen), _AT_ONCE):
            stretch = slice(start, start + _AT_ONCE)
            # Of one mesh alone no copies are made
            part = stretch if len(chosen) == len(fragments.triangle) else chosen[stretch]
            numbers = fragments.triangle[part]
            parts.append(MeshFragments(mesh, part, listed[part], numbers, pixel[part], fragments.weight[part]))
    return parts


_APART = 0.4
"""Fragments of a group follow each other within this distance along the ray, in widths of a pixel. Chosen so that
99.99 % of the values that a layer changes stay within a code of those without groups, for two bodies and for twenty.
Twice as much casts a quarter fewer rays, and 99.986 % stay; half as much casts a fifth more."""
_BEND = 0.7
"""Least cosine between the normals of fragments that follow each other in a group."""


_NEAR = 0.01
"""Largest difference in distance, relative, of a pixel from those beside it whose sight of the sun it shares."""


@dataclass(frozen=True, slots=True, eq=False)
class SunGroups:
    """Groups of fragments of one mesh that see the same of the sun, m of them.

    of: (n,) group of each fragment, -1 for those that face away from the sun. listed: (m, 9) of each group what
    `MeshFragments` lists. surface: (m, 4) its unit normal and distance. first: (m,) whether rays are cast from it
    before `fill_between`.
    """

    of: NDArray[np.int64]
    listed: Floats
    surface: Floats
    first: NDArray[np.bool_]

    def fill_between(self, seen: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Set what groups see of the sun (m, k) that lie between others that see all or nothing, and return the groups
        (m,) from which rays are still to be cast.
        """
        column, row = np.floor(self.listed[:, 1:3]).astype(np.int64).T
        left = ~self.first
        if not np.any(left):
            return left
        row, column = row - row.min() // 2 * 2, column - column.min() // 2 * 2
        table = np.full((row.max() // 2 + 2, column.max() // 2 + 2), -1, np.int64)
        known = np.flatnonzero(self.first)
        known = known[(row[known] | column[known]) & 1 == 0]
        table[row[known] // 2, column[known] // 2] = known
        _between(row, column, self.listed[:, 3], self.surface, table, seen, left)
        return left


def sun_groups(shot: Shot, part: MeshFragments, facets: NDArray[np.float32], sun: Floats) -> SunGroups:
    """Return the groups of the fragments of one mesh. facets: of `Surfaces`. sun: (3,) direction in the world."""
    surface = fragment_planes(shot, part, facets, sun)
    apart = _APART * np.pi / shot.view.height if shot.draw.shading != "sample" else -1.0
    of, chosen = np.full(len(part.listed), -1, np.int64), np.zeros(len(part.listed), np.int64)
    area = np.zeros((len(part.listed), 5))
    count = _group(part.listed, part.pixel, part.weight, surface, apart, of, chosen, area)
    chosen = chosen[:count]
    listed, pixel = part.listed[chosen], part.pixel[chosen]
    listed[:, 4:] = area[:count]
    # a pixel with several groups has an edge of the body: all of its groups are asked
    beside = np.diff(pixel, prepend=-1, append=-1) != 0
    even = np.all(np.floor(listed[:, 1:3]) % 2.0 == 0.0, axis=1)
    return SunGroups(of, listed, surface[chosen, :4], even | ~(beside[:-1] & beside[1:]))


def fragment_planes(shot: Shot, part: MeshFragments, facets: NDArray[np.float32], towards: Floats) -> Floats:
    """Return the surfaces (n, 5) of fragments: unit normal in the camera's axes, distance along the ray, and whether
    they face a light in the direction `towards` (3,); of those that do not, nothing else.
    """
    view, surface = shot.view, np.empty((len(part.listed), 5))
    size = float(view.width), float(view.height)
    _meet(part.listed, facets, part.triangle, view.world_from_camera.T @ towards, float(view.eye_m), *size, surface)
    return surface


@exact
def _between(row: Any, column: Any, body: Any, surface: Any, table: Any, seen: Any, left: Any) -> None:
    """Set `seen` (m, k) of the groups that are left, (m,), where all beside them see the same, 1 or 0, and are of the
    same surface; those are left no more.

    table: of every second row and column, the group of its pixel, -1 for none.
    """
    for n in range(len(left)):
        if not left[n]:
            continue
        r, c, alike, found = row[n], column[n], True, 0
        for k in range(4):
            found = table[(r + k // 2) // 2, (c + k % 2) // 2] if alike else found
            alike = alike and found >= 0 and body[found] == body[n]
            if not alike:
                continue
            cosine = 0.0
            for axis in range(3):
                cosine += surface[found, axis] * surface[n, axis]
            alike = cosine >= _BEND and abs(surface[found, 3] - surface[n, 3]) <= _NEAR * surface[n, 3]
            for j in range(seen.shape[1]):
                value = seen[found, j]
                alike = alike and (value == 0.0 or value == 1.0) and (k == 0 or value == seen[n, j])
                seen[n, j] = value
        left[n] = not alike


@exact
def _meet(listed: Any, facets: Any, triangle: Any, sun: Any, eye: Any, width: Any, height: Any, surface: Any) -> None:
    """Set `surface` (n, 5) of fragments (n, 9): unit normal, distance along the ray, and whether it faces the sun; of
    those that do not, nothing else.

    facets, triangle: the planes of fragments. sun: (3,) its direction in the camera's axes; zero where all count as
    facing it. eye: [m] to the right of the middle of a stereo camera. width, height: of the frame.
    """
    for n in range(len(listed)):
        t = triangle[n]
        x = np.float64(facets[t, 0]) + facets[t, 3] + facets[t, 6]
        y = np.float64(facets[t, 1]) + facets[t, 4] + facets[t, 7]
        z = np.float64(facets[t, 2]) + facets[t, 5] + facets[t, 8]
        # The plane is where the product is 1: the camera's side is that where it is less
        surface[n, 4] = 1.0 if x * sun[0] + y * sun[1] + z * sun[2] <= 0.0 else 0.0
        if surface[n, 4] == 0.0:
            continue
        lon, lat = 2.0 * np.pi * (listed[n, 1] / width - 0.5), np.pi * (0.5 - listed[n, 2] / height)
        dx, dy, dz = np.cos(lat) * np.sin(lon), np.sin(lat), -np.cos(lat) * np.cos(lon)
        long, along = np.sqrt(x * x + y * y + z * z), x * dx + y * dy + z * dz
        surface[n, 0], surface[n, 1], surface[n, 2] = x / long, y / long, z / long
        surface[n, 3] = (1.0 - eye * (z * dx - x * dz)) / along if along != 0.0 else 0.0


@exact
def _follows(listed: Any, pixel: Any, surface: Any, apart: Any, before: Any, n: Any) -> Any:
    """Return whether a fragment belongs to the group of the one before it."""
    if pixel[n] != pixel[before] or listed[n, 3] != listed[before, 3]:
        return False
    cosine = 0.0
    for k in range(3):
        cosine += surface[n, k] * surface[before, k]
    return cosine >= _BEND and abs(surface[n, 3] - surface[before, 3]) <= apart * surface[before, 3]


@exact_making
def _group(listed: Any, pixel: Any, weight: Any, surface: Any, apart: Any, of: Any, chosen: Any, area: Any) -> Any:
    """Set the group (n,) of each fragment, and of each group the fragment with most samples (m,) and the area (m, 5) of
    all, as `sampling.frame_areas`; return their number m.
    """
    count, before = 0, -1
    moments = np.zeros((len(listed), 6))  # of groups: weight, mean, and second moments about the place of `origin`
    origin = np.zeros((len(listed), 2))
    most = np.zeros(len(listed))
    for n in range(len(listed)):
        if surface[n, 4] == 0.0:
            continue
        if before < 0 or not _follows(listed, pixel, surface, apart, before, n):
            origin[count, 0], origin[count, 1] = listed[n, 1], listed[n, 2]
            count += 1
        k, w = count - 1, weight[n]
        x, y = listed[n, 1] + listed[n, 4] - origin[k, 0], listed[n, 2] + listed[n, 5] - origin[k, 1]
        a, b, c = listed[n, 6], listed[n, 7], listed[n, 8]
        parts = (1.0, x, y, x * x + (a * a + b * b) / 12.0, x * y + (a + c) * b / 12.0, y * y + (b * b + c * c) / 12.0)
        for m in range(6):
            moments[k, m] += w * parts[m]
        if w > most[k]:
            most[k], chosen[k] = w, n
        of[n], before = k, n
    for k in range(count):
        x, y = moments[k, 1] / moments[k, 0], moments[k, 2] / moments[k, 0]
        xx, xy = moments[k, 3] / moments[k, 0] - x * x, moments[k, 4] / moments[k, 0] - x * y
        yy = moments[k, 5] / moments[k, 0] - y * y
        area[k, 0], area[k, 1] = origin[k, 0] + x - listed[chosen[k], 1], origin[k, 1] + y - listed[chosen[k], 2]
        area[k, 2], area[k, 3], area[k, 4] = root_of_moments(xx, xy, yy, 0.0)
    return count
