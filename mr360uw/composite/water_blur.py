# SPDX-License-Identifier: Apache-2.0
"""Blur of bodies by the water between them and the camera, which turns their light by small angles.

What a body changes of the plate, D = L - P, reaches the camera as the light of a source there does: a part arrives
unturned, the rest beside where it left, by the spread of the sun's beam read backwards (`scattered_light`):

    picture = P + k g D + sum over i of G_i * ((1 - k) w_i g D)        k = exp(-tau)

L: light of the body with its veil. P: the plate in its place, smooth. G_i: Gaussians of fixed angles, of sum 1 over the
sphere. tau, w_i: optical depth of turning, and shares of the Gaussians, at the body's distance. Extinction takes light
that turns by wide angles off a body; what of it turns by less than the cone of 45 degrees comes back as blur, hence g.
A body takes no more light away than comes from behind it: g D is W - P at least, W the light that the water before it
turns into the ray by wider angles. With V the veil and T the transmittance of that water, W = V (1 - g T)/(1 - T), as
if it went on evenly. Before the window of the surface W is 0: the sky that the water would turn is behind the body too.

The Gaussians are found on grids, each as coarse as its Gaussian allows, and narrower ones than a cell count as
unturned. Both renderers share it: it needs the layer's radiance and distances alone. Time grows with the pixels of
bodies, and with those about them whose codes change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache
from mr360uw.base.constants import PI
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.receiver.shape import plate_distance
from mr360uw.composite.shading import veil_ahead
from mr360uw.composite.shafts import code_change, pixels_of_blocks
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles, places_in_mask, rectangles_of_mask, tile_of
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.jit import fast, fast_making
from mr360uw.medium.lookup import table_coordinate, transmittance_lookup
from mr360uw.medium.models import window_share
from mr360uw.types import BeamSpread, Floats, Layer, Rectangle

_CELLS = 480
"""Most cells around the horizon: 0.75 degrees each."""
_COARSEST = 180
"""Most cells around the horizon of the coarsest grid, as even dimensions allow: wider ones lose light at the poles."""
_NARROWEST, _FINEST = 0.6, 1.4
"""Standard deviations, in cells, below which a Gaussian counts as unturned, and from which on a grid serves it."""
_BACKGROUND_ROWS = 64
"""Rows of the plate's light behind bodies: what is smaller than 3 degrees does not shine through them."""
_LENGTH_M, _NODES = 10.0, 1024
"""Distances S are tabulated uniformly in S/(S + this), in so many places."""
_NODE_M = _LENGTH_M / (1.0 - np.arange(_NODES) / _NODES) - _LENGTH_M
"""The distances (n,) [m] there."""
_FAINTEST, _FAINT = 0.03, 0.1
"""Transmittances up to which nothing, and from which on all of the blur is drawn."""
_LEAST_GROUND = 0.01
"""Least change of the ground that is blurred, over the light of the plate."""
_LEAST_CODES, _STEEPEST = 0.5, 255.0 * 4.5
"""Change of a code from which on light beside bodies is drawn, all of it from twice as much on; most codes that light
of 1 changes, near black."""


def with_blur(
    shot: Shot, spread: BeamSpread, layer: Layer, variables: Aovs | None, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return a shot's layer and output variables as the water blurs them. cache: holds what does not change."""
    view, medium = shot.view, shot.medium
    assert medium is not None, "the plan blurs nothing without water"
    side = max(view.width // _CELLS, 1)
    rows, columns = -(-view.height // side), -(-view.width // side)
    # Find the light of bodies in each cell that they cover
    cells = np.zeros((rows, columns, 5), np.float32)
    for tile in layer.tiles:
        _add_cells(tile.radiance, tile.alpha, tile.distance_m, tile.row, tile.column, side, cells)
    bodies = places_in_mask(cells[..., 3] > 0.0)
    if not len(bodies[0]) or medium.camera_depth_m <= 0.0:
        return layer, variables
    # Find what they change of the plate, and of the ground
    light, share, metres = np.split(cells[bodies], [3, 4], axis=1)
    behind, water = _background(shot, rows, columns, float(metres.sum() / share.sum()))
    ground, far, dimmed = _ground_change(shot, layer, side, behind, cells[..., 3], cache)
    places = np.concatenate([bodies[0], ground[0]]), np.concatenate([bodies[1], ground[1]])
    plate, change = behind[places], np.concatenate([light - share * behind[bodies], dimmed])
    plate[: len(share)] *= share
    # Spread the part of it that has turned
    left = transmittance_lookup(medium, _NODE_M, np.zeros(_NODES))
    blur = np.clip((left - _FAINTEST) / (_FAINT - _FAINTEST), 0.0, 1.0).astype(np.float32)
    table, distance = cache.of(_by_distance, spread, columns), np.concatenate([(metres / share)[:, 0], far])
    node = np.minimum(_NODES * table_coordinate(distance, _LENGTH_M) + 0.5, _NODES - 1).astype(np.int64)
    (gain, sharp, *turned), shown, count = table[:, node], blur[node], len(share)
    wide = np.maximum(1.0 - table[0] * left, 0.0).astype(np.float32)
    plate[:count] = np.maximum(plate[:count] - share * wide[node[:count]] * water[bodies], 0.0)
    change = shown * np.maximum(gain * change, -plate)
    from_bodies, from_ground = (
        _spread(spread.angle_rad, (rows, columns), at, [(fraction * change)[of] for fraction in turned])
        for at, of in ((bodies, slice(count)), (ground, slice(count, None)))
    )
    on_plate = from_bodies + from_ground
    on_plate[ground] += (sharp * change)[count:] - shown[count:] * dimmed
    # Of the ground's light the share turns before a body that its distance is of the ground's
    of_ground = np.abs(change[count:, 1])
    per_m = np.float32(of_ground.sum() / max(float(of_ground @ far), 1e-30))
    # Draw the plate where its codes change, and bodies anew
    marked = np.einsum("jic,jic->ji", on_plate, on_plate) > (_LEAST_CODES / _STEEPEST) ** 2
    codes = np.zeros(marked.shape, np.float32)
    codes[marked] = code_change(behind[marked], on_plate[marked])
    marked = codes > _LEAST_CODES
    drawn = np.zeros_like(on_plate)
    drawn[marked] = on_plate[marked] * np.minimum(codes[marked] / _LEAST_CODES - 1.0, 1.0)[:, None]
    more = [Rectangle(*(side * number for number in part)) for part in rectangles_of_mask(marked, _CELLS)]
    of_layer, tiles = {tile.rectangle: tile for tile in layer.tiles}, []
    for part in even_tiles([*of_layer, *more], view.width, view.height):
        tile = of_layer[part] if part in of_layer else tile_of(layer, part)
        window = tuple(slice(low // side, -(-high // side)) for low, high in (
            (part.row, part.row + part.height), (part.column, part.column + part.width)
        ))  # fmt: skip
        if np.any(marked[window]):
            shafts = pixels_of_blocks(drawn, side, part)
            if shot.holdout is not None:
                shafts = shafts * (1.0 - np.clip(shot.holdout[tile.window], 0.0, 1.0))[..., None]
            shafts = shafts if tile.shafts is None else tile.shafts + shafts
            tile = replace(tile, shafts=np.ascontiguousarray(shafts, np.float32))
        if np.any(cells[window][..., 3]):
            radiance = tile.radiance.copy()
            first = part.row, part.column
            maps = behind, water, from_bodies, from_ground, per_m
            _blur_bodies(radiance, tile.alpha, tile.distance_m, first, (table, blur, wide), side, maps)
            tile = replace(tile, radiance=radiance)
        tiles.append(tile)
    if variables is not None:
        change_of_bodies = variables.shafts.copy()
        for tile in tiles:
            change_of_bodies[tile.window] += tile.radiance - tile_of(layer, tile.rectangle).radiance
        variables = replace(variables, shafts=change_of_bodies)
    return replace(layer, tiles=tuple(tiles)), variables


def _by_distance(spread: BeamSpread, columns: int) -> NDArray[np.float32]:
    """Return numbers (2 + k, `_NODES`, 3) of light that came over distances of `_NODE_M`; columns: of cells, around.

    Light with that which turned within the cone, over light without; fractions of it that stayed in their place, and
    that each of the k Gaussians spreads, none by the narrow ones that count as unturned.
    """
    distance_m = _NODE_M[:, None]
    gain = np.exp(np.minimum(distance_m * spread.kept, 80.0))  # a float32 holds that
    weights = spread.weights(distance_m) * (spread.angle_rad >= _NARROWEST * 2.0 * PI / columns)
    turned = (1.0 - np.exp(-distance_m * spread.scattering))[..., None] * weights
    return np.stack([gain, 1.0 - turned.sum(axis=-1), *np.moveaxis(turned, -1, 0)]).astype(np.float32)


def _ground_change(
    shot: Shot, layer: Layer, side: int, behind: Floats, share: Floats, cache: Cache
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], Floats, Floats]:
    """Return rows and columns of the cells in which a layer changes the ground, its distances (n,) and change (n, 3).

    One line of pixels stands for a row of cells. share: (rows, columns) of cells that bodies cover.
    """
    found = np.zeros((*share.shape, 3), np.float32)
    for tile in layer.tiles if shot.receiver is not None else ():
        # The first line in the middle of a row of cells
        part = tile.rectangle
        first = (side // 2 - part.row) % side
        if first < part.height:
            drawn = tile.ratio[first::side], tile.veil[first::side]
            ratio, veil = drawn if layer.ground is None else layer.ground.lines_of(part, first, side)
            _add_ground(ratio, veil, (part.row + first) // side, part.column, side, behind, found)
    # Cells that no body covers, and whose change may show
    at = places_in_mask(found[..., 1] != 0.0)
    change, plate = found[at] * (1.0 - share[at])[:, None], behind[at]
    far = np.sum(change * change, axis=1) > _LEAST_GROUND**2 * np.sum(plate * plate, axis=1)
    row, column, change = at[0][far], at[1][far], change[far]
    x, y = (column + 0.5) * side, np.minimum((row + 0.5) * side, shot.view.height - 0.5)
    far = plate_distance(shot, x, y, np.asarray(shot.view.directions(x, y), np.float64), cache)
    near = np.isfinite(far)
    return (row[near], column[near]), far[near], change[near]


@fast
def _add_ground(ratio: Any, veil: Any, top: int, column: int, side: int, behind: Any, found: Any) -> None:
    """Add what lines of a tile, ratio and veil (n, w, 3), change of the ground to rows of cells from `top` on.

    column: the first pixel's. behind: (rows, columns, 3) light of the plate in cells; found: is added to, likewise.
    """
    for r in range(ratio.shape[0]):
        for i in range(ratio.shape[1]):
            at = (column + i) // side
            for c in range(3):
                plate = behind[top + r, at, c]
                found[top + r, at, c] += (plate - min(veil[r, i, c], plate)) * (ratio[r, i, c] - np.float32(1.0)) / side


def _background(shot: Shot, rows: int, columns: int, distance_m: float) -> tuple[Floats, Floats]:
    """Return the plate's light without its sun (rows, columns, 3), smooth, in the frame's directions, and that of the
    water up to a distance if it went on so: none in Snell's window.
    """
    view, light, medium = shot.view, shot.environment, shot.medium
    assert medium is not None
    side = max(rows // _BACKGROUND_ROWS, 1)
    row, column = (side * (np.arange(-(-cells // side)) + 0.5) for cells in (rows, columns))
    directions = view.directions(*np.meshgrid(column * (view.width / columns), row * (view.height / rows)))
    seen = environment_lookup(light.residual if light.detail is None else light.detail, directions)
    up = np.asarray(directions[..., 1], np.float64)
    distance = np.full(up.shape, distance_m)
    lost = np.maximum(1.0 - transmittance_lookup(medium, distance, up), 1e-6)
    below = 1.0 - window_share(up, shot.refractive_index)
    water = below[..., None] * veil_ahead(medium, distance, directions) / lost
    whole = Rectangle(0, 0, columns, rows)
    first, second = (pixels_of_blocks(of.astype(np.float32), side, whole) for of in (seen, water))
    return np.ascontiguousarray(first), np.ascontiguousarray(second)


@fast
def _add_cells(radiance: Any, alpha: Any, metres: Any, row: int, column: int, side: int, cells: Any) -> None:
    """Add means of radiance, coverage and covered metres of a tile's bodies to the cells (rows, columns, 5) of theirs.

    radiance, alpha, metres: of the tile, whose first pixel is at (row, column).
    """
    area = np.float32(1.0 / (side * side))
    for j in range(alpha.shape[0]):
        for i in range(alpha.shape[1]):
            if alpha[j, i] > 0.0:
                at, to, covered = (row + j) // side, (column + i) // side, area * alpha[j, i]
                for c in range(3):
                    cells[at, to, c] += area * radiance[j, i, c]
                cells[at, to, 3] += covered
                cells[at, to, 4] += covered * metres[j, i]


def _spread(
    angle_rad: Floats, shape: tuple[int, int], at: tuple[NDArray[np.int64], NDArray[np.int64]], turned: Sequence[Floats]
) -> NDArray[np.float32]:
    """Return light that the water has turned (rows, columns, 3).

    angle_rad: (k,) of the Gaussians. shape: rows and columns of cells; at: those of the cells that light comes from.
    turned: (n, 3) of each Gaussian.
    """
    grids = [np.zeros((*shape, 3), np.float32)]
    sigma, from_area = angle_rad * shape[1] / (2.0 * PI), np.cos(PI * (0.5 - (at[0] + 0.5) / shape[0]))
    while grids[-1].shape[1] > _COARSEST and not grids[-1].shape[0] % 2 and not grids[-1].shape[1] % 2:
        rows, columns, _ = grids[-1].shape
        grids.append(np.zeros((rows // 2, columns // 2, 3), np.float32))
    # Each Gaussian on the coarsest grid that serves it: cosines of latitudes are areas of cells
    for k, light in enumerate(turned):
        if not np.any(light):
            continue
        level = int(np.clip(np.floor(np.log2(sigma[k] / _FINEST)), 0, len(grids) - 1))
        rows, columns, _ = grids[level].shape
        row, cosine = at[0] >> level, np.cos(PI * (0.5 - (np.arange(rows) + 0.5) / rows))
        place, area = row * columns + (at[1] >> level), from_area / cosine[row] / 4.0**level
        source = [np.bincount(place, area * light[:, c], rows * columns) for c in range(3)]
        source_map = np.stack(source, -1, dtype=np.float32).reshape(rows, columns, 3)
        _blur(source_map, sigma[k] / 2.0**level, cosine, grids[level])
    # Sum them from the coarsest grid on
    found = grids.pop()
    while grids:
        finer = grids.pop()
        finer += pixels_of_blocks(found, 2, Rectangle(0, 0, finer.shape[1], finer.shape[0]))
        found = finer
    return found


@fast_making
def _blur(source: Any, sigma: Any, cosine: Any, out: Any) -> None:
    """Add what a Gaussian of so many cells makes of a map (h, w, 3) of the sphere; cosine: (h,) of the latitudes.

    Along rows and then along columns, which go on beyond a pole half a turn away. No light is lost.
    """
    height, width, _ = source.shape
    along, weight = np.zeros((height, width, 3), np.float32), np.zeros(width + 1, np.float32)
    lit = np.zeros(height, np.bool_)
    for row in range(height):
        # Weights along this row, as far as three deviations and at most half around
        across, total, reach = sigma / cosine[row], 0.0, 0
        for column in range(width):
            if source[row, column, 0] == 0.0 and source[row, column, 1] == 0.0 and source[row, column, 2] == 0.0:
                continue
            if not lit[row]:
                lit[row], reach = True, min(int(3.0 * across) + 1, width // 2)
                for k in range(-reach, reach + 1):
                    weight[k + reach] = np.exp(-0.5 * (k / across) ** 2)
                    total += weight[k + reach]
            for k in range(2 * reach + 1):
                to, of = column + k - reach, weight[k] / total
                to += width if to < 0 else -width if to >= width else 0
                for c in range(3):
                    along[row, to, c] += of * source[row, column, c]
    reach = min(int(3.0 * sigma) + 1, height - 1)
    for row in range(height):
        if not lit[row]:
            continue
        # Weights along a meridian, by the areas of the cells that the light goes to
        total = 0.0
        for k in range(2 * reach + 1):
            to = row + k - reach
            to = -1 - to if to < 0 else 2 * height - 1 - to if to >= height else to
            weight[k] = np.exp(-0.5 * ((k - reach) / sigma) ** 2)
            total += weight[k] * cosine[to]
        for k in range(2 * reach + 1):
            to, shift, of = row + k - reach, 0, np.float32(weight[k] * cosine[row] / total)
            if to < 0 or to >= height:
                to, shift = (-1 - to if to < 0 else 2 * height - 1 - to), width // 2
            for column in range(width - shift):
                for c in range(3):
                    out[to, column + shift, c] += of * along[row, column, c]
            for column in range(width - shift, width):
                for c in range(3):
                    out[to, column + shift - width, c] += of * along[row, column, c]


@fast
def _blur_bodies(radiance: Any, alpha: Any, metres: Any, place: Any, over_distance: Any, side: int, maps: Any) -> None:
    """Blur the bodies of a tile, whose first pixel is at place, in its radiance (h, w, 3).

    over_distance: table of `_by_distance`; (`_NODES`, 3) how much of the blur is drawn there, and what part of the
    water's light is before a body. maps: (rows, columns, 3) light of the plate and of the water, and what has turned of
    that of bodies and of the ground, in cells; and one over the ground's distance [1/m].
    """
    (table, blur, wide), (behind, water, from_bodies, from_ground, per_m) = over_distance, maps
    (rows, columns, _), (row, column) = behind.shape, place
    for j in range(alpha.shape[0]):
        # Cells above and below this line
        y = max((row + j + 0.5) / side - 0.5, 0.0)
        top = min(int(y), rows - 1)
        low, down = min(top + 1, rows - 1), np.float32(y - top)
        for i in range(alpha.shape[1]):
            covered = alpha[j, i]
            if covered == 0.0:
                continue
            x = (column + i + 0.5) / side - 0.5 + columns
            left = int(x)
            across = np.float32(x - left)
            left, right = left % columns, (left + 1) % columns
            before = min(per_m * metres[j, i], np.float32(1.0))
            node = int(_NODES * metres[j, i] / (metres[j, i] + _LENGTH_M) + 0.5)
            node = min(node, _NODES - 1)
            for c in range(3):
                # Light of the cells here, linear between their middles
                upper = behind[top, left, c] + across * (behind[top, right, c] - behind[top, left, c])
                lower = behind[low, left, c] + across * (behind[low, right, c] - behind[low, left, c])
                plate = covered * (upper + down * (lower - upper))
                upper = water[top, left, c] + across * (water[top, right, c] - water[top, left, c])
                lower = water[low, left, c] + across * (water[low, right, c] - water[low, left, c])
                most = max(plate - covered * wide[node, c] * (upper + down * (lower - upper)), np.float32(0.0))
                upper = from_bodies[top, left, c] + across * (from_bodies[top, right, c] - from_bodies[top, left, c])
                lower = from_bodies[low, left, c] + across * (from_bodies[low, right, c] - from_bodies[low, left, c])
                turned = upper + down * (lower - upper)
                upper = from_ground[top, left, c] + across * (from_ground[top, right, c] - from_ground[top, left, c])
                lower = from_ground[low, left, c] + across * (from_ground[low, right, c] - from_ground[low, left, c])
                turned += before * (upper + down * (lower - upper))
                # What has not turned, and narrow Gaussians, stay where they are
                own = radiance[j, i, c]
                change = max(table[0, node, c] * (own - plate), -most)
                blurred = max(plate + table[1, node, c] * change + covered * turned, np.float32(0.0))
                radiance[j, i, c] = own + blur[node, c] * (blurred - own)
