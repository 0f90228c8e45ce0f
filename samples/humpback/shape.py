# SPDX-License-Identifier: Apache-2.0
"""The closed skin of a humpback whale: a lofted body out of which pectorals, flukes and dorsal fin are extruded.

All lengths are in body lengths, from the snout (s = 0) to the notch of the flukes (s = 1): z = 1/2 - s, so that the
front is +z; +y is up and +x the animal's left. The body is a grid of sections. A fin takes the place of a rectangle of
its cells and continues the rim of that rectangle, so that the skin has neither cracks nor intersections, and every fin
has a chart of its own on the texture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from importlib import resources
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.texels import smoothstep
from mr360uw.medium.spectra import parse_table
from mr360uw.types import Floats

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Detail = Literal["high", "low"]


_VERTICES: dict[Detail, tuple[int, ...]] = {"high": (122, 64, 4, 46, 30, 9), "low": (36, 20, 2, 9, 8, 3)}
"""By level of detail: sections of the body; vertices around each, a multiple of 4; cells of the body across the root of
a fin, even; rings along a pectoral, a fluke and the dorsal fin."""


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """A grid of vertices with a rectangle of the texture; rows go around the body or fin, columns along it.

    vertex: (R, C) numbers of vertices; the last row is the first one again. drawn: (R-1, C-1) whether a cell is skin;
    those that are not are where fins begin. along, around: knots from 0 to 1 of columns (C,) and rows (R,) on the
    texture. place: (C,) s of the sections of the body, or the fraction of the length of a fin.
    """

    name: str
    vertex: NDArray[np.int64]
    drawn: NDArray[np.bool_]
    along: Floats
    around: Floats
    place: Floats


@dataclass(frozen=True, eq=False)
class WhaleSkin:
    """A closed surface. positions: (V, 3), with some that no triangle uses; charts: the body's, then those of fins."""

    positions: Floats
    charts: tuple[Chart, ...]

    @cached_property
    def faces(self) -> NDArray[np.int64]:
        """Triangles (T, 3) of vertex numbers, anticlockwise from outside."""
        corners = (triangles(chart.drawn) for chart in self.charts)
        faces = np.concatenate([c.vertex.ravel()[f] for c, f in zip(self.charts, corners, strict=True)])
        # at the poles, where a row of cells meets in one vertex, half of the triangles have no area
        return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]

    @cached_property
    def normals(self) -> Floats:
        """Outward unit normals (V, 3), means over the triangles around each vertex by area."""
        corners, faces = self.positions[self.faces], self.faces.ravel()
        area = np.repeat(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), 3, axis=0)
        total = np.stack([np.bincount(faces, along, len(self.positions)) for along in area.T], axis=-1)
        return total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-30)


def triangles(drawn: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return triangles (T, 3) of the drawn cells of a grid (R-1, C-1), as numbers of its vertices row by row."""
    columns = drawn.shape[1] + 1
    j, i = np.nonzero(drawn)
    a = j * columns + i
    b, c, d = a + 1, a + columns + 1, a + columns
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def humpback(detail: Detail) -> WhaleSkin:
    """Return the skin of a humpback whale at rest, one body length long."""
    rings, sides, thick, pectoral, fluke, dorsal = _VERTICES[detail]
    s = _stations(rings)
    angle = 2.0 * np.pi * np.arange(sides) / sides - 0.5 * np.pi
    grid = body_surface(*np.meshgrid(s, angle))
    builder = _Builder(s, angle, grid)
    # Roots of fins: (first s, last s, angle of the middle), and what grows there
    half = thick // 2
    for side, name in ((1.0, "left"), (-1.0, "right")):
        builder.extrude(
            f"{name} pectoral", (0.285, 0.365), _turned(-0.45, side), half, partial(_pectoral, side), pectoral
        )
    for side, name in ((1.0, "left"), (-1.0, "right")):
        builder.extrude(f"{name} fluke", (0.905, 0.988), _turned(0.0, side), half, partial(_fluke, side), fluke)
    builder.extrude("dorsal fin", (0.605, 0.685), 0.5 * np.pi, half, _dorsal, dorsal)
    return builder.skin()


# ------------------------------------------------------------------------------------------------------------- the body

_END = 0.965
"""Where the rounding of the tail's end begins."""
_LIP = np.array([(0.0, 0.000), (0.03, 0.003), (0.08, 0.006), (0.14, 0.007), (0.175, 0.002), (0.205, -0.014),
                 (0.235, -0.040), (0.26, -0.055)])  # fmt: skip
"""(s, y) of the line between the lips, whose corner is below and behind the eye."""
EYE = (0.222, -0.0095)
"""(s, y) of the eye's middle."""


def profile(s: ArrayLike, column: str) -> Floats:
    """Return a column of `whale_profile.csv` at s: "top", "bottom", "width", "widest" or "power"."""
    from scipy.interpolate import PchipInterpolator

    # in the square root of s, in which the snout is round
    table = _profile_table()
    return np.asarray(PchipInterpolator(np.sqrt(table["s"]), table[column])(np.sqrt(s)))


@cache
def _profile_table() -> dict[str, NDArray[np.float64]]:
    name = "whale_profile.csv"
    return parse_table((resources.files("mr360uw.sample") / name).read_text(encoding="utf-8").splitlines(), name)


def above_lips(s: ArrayLike, y: ArrayLike) -> Floats:
    """Return the signed distance of points of the body's side from the line between the lips, positive above it."""
    from scipy.interpolate import PchipInterpolator

    line, s = PchipInterpolator(_LIP[:, 0], _LIP[:, 1]), np.clip(s, 0.0, _LIP[-1, 0])
    return np.asarray((np.asarray(y) - line(s)) / np.hypot(1.0, line.derivative()(s)))


def _bump(x: ArrayLike, middle: float, width: float) -> Floats:
    return np.asarray(np.exp(-(((np.asarray(x) - middle) / width) ** 2)))


def body_surface(s: Floats, angle: Floats) -> Floats:
    """Return points (..., 3) of the body at s and angle around it: 0 the left, pi/2 the back, -pi/2 the belly."""
    top, bottom, width, widest, power = (profile(s, c) for c in ("top", "bottom", "width", "widest", "power"))
    cosine, sine = np.cos(angle), np.sin(angle)
    # Close the tail with a quarter of an ellipse
    end = np.sqrt(np.maximum(1.0 - (np.maximum(s - _END, 0.0) / (1.0 - _END)) ** 2, 0.0))
    y = widest + end * np.where(sine > 0.0, (top - widest) * sine, (widest - bottom) * sine)
    x = end * width * np.sign(cosine) * np.abs(cosine) ** power
    # Set the upper jaw back from the lower one, whose lip bulges out
    jaw = smoothstep(s, 0.235, 0.16) * smoothstep(s, 0.0, 0.012)
    over = above_lips(s, y)
    x = x * (1.0 - 0.12 * jaw * smoothstep(over, -0.003, 0.005) + 0.035 * jaw * _bump(over, -0.012, 0.010))
    # Raise the ridge of the rostrum, the guard before the blowholes, the hump before the dorsal fin, the tail's keel
    upper = np.maximum(sine, 0.0)
    y = y + upper * 0.0045 * _bump(x, 0.0, 0.010) * smoothstep(s, 0.02, 0.06) * smoothstep(s, 0.19, 0.15)
    y = y + upper * 0.0110 * _bump(s, 0.188, 0.016) * _bump(x, 0.0, 0.018)
    y = y - upper * 0.0040 * _bump(s, 0.225, 0.018) * _bump(x, 0.0, 0.030)
    y = y + upper * 0.0090 * _bump(s, 0.605, 0.050) * _bump(x, 0.0, 0.025)
    # Let the lids stand out
    away = np.hypot(s - EYE[0], y - EYE[1])
    x = x + np.sign(cosine) * 0.0040 * np.exp(-((away / 0.0110) ** 2))
    return np.stack([x, y, 0.5 - s], axis=-1)


def _stations(count: int) -> Floats:
    """Return s of sections, close together on the head and at the flukes."""
    dense = np.array([(0.0, 9.0), (0.004, 6.0), (0.02, 2.5), (0.06, 1.5), (0.25, 1.3), (0.4, 0.95), (0.55, 0.7),
                      (0.6, 0.9), (0.7, 0.9), (0.75, 0.7), (0.88, 0.8), (0.92, 1.2), (0.98, 1.6),
                      (1.0, 6.0)])  # fmt: skip
    fine = np.linspace(0.0, 1.0, 4001)
    total = np.cumsum(np.interp(fine, dense[:, 0], dense[:, 1]))
    # the poles themselves are the chart's first and last columns
    return np.interp((np.arange(count) + 0.5) / count * total[-1], total, fine)


# ------------------------------------------------------------------------------------------------------------- the fins


def _turned(angle: float, side: float) -> float:
    """Return an angle of the left side, or its mirror image on the right one."""
    return angle if side > 0.0 else np.pi - angle


Fin = Callable[[Floats], tuple[Floats, Floats, Floats, Floats]]
"""Gives a fin at fractions (k,) of its length: the leading and the trailing edge (k, 3), unit vectors (k, 3) across it,
towards higher rows of the body's grid, and the thickness (k,) of its sections."""
_TUBERCLES = np.array([(0.10, 0.0095), (0.19, 0.0060), (0.28, 0.0060), (0.37, 0.0090), (0.46, 0.0062), (0.55, 0.0058),
                       (0.635, 0.0052), (0.715, 0.0048), (0.79, 0.0042), (0.86, 0.0038)])  # fmt: skip
"""Place along a pectoral and height of the ten tubercles of its leading edge, of which the first and fourth are the
largest. Sections are 0.2 to 0.28 of their chord thick (Fish & Battle 1995)."""


def _pectoral(side: float, t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the left (side 1) or right (-1) pectoral: swept back, drooping, its leading edge scalloped."""
    # Follow the span outwards, ever more swept back
    fine = np.linspace(0.0, 1.0, 101)
    sweep, droop = 0.50 + 0.40 * fine, 0.50 - 0.25 * fine
    step = np.stack([side * np.cos(sweep) * np.cos(droop), -np.sin(droop), -np.sin(sweep) * np.cos(droop)], axis=-1)
    path = body_surface(np.array(0.325), np.array(_turned(-0.45, side))) + 0.31 * np.cumsum(step, axis=0) / len(fine)
    span, outwards = (np.stack([np.interp(t, fine, rows[:, k]) for k in range(3)], axis=-1) for rows in (path, step))
    # The chord is along the body at the root, and across the span from a third of it on
    up = np.array([0.0, 1.0, 0.12]) - outwards * (outwards @ [0.0, 1.0, 0.12])[:, None]
    up = up / np.linalg.norm(up, axis=-1, keepdims=True)
    turn = smoothstep(t, 0.0, 0.3)[:, None]
    back = (1.0 - turn) * [0.0, 0.0, -1.0] + turn * side * np.cross(up, outwards)
    back = back / np.linalg.norm(back, axis=-1, keepdims=True)
    chord = _curve(t, [0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 0.92, 0.98, 1.0],
                   [0.066, 0.068, 0.074, 0.073, 0.064, 0.046, 0.031, 0.018, 0.006])  # fmt: skip
    # Tubercles on the leading edge, slight waves on the trailing one
    knobs = sum(height * _bump(t, place, 0.026) for place, height in _TUBERCLES)
    waves = 0.0012 * np.sin(40.0 * t) * smoothstep(t, 0.15, 0.4) * smoothstep(t, 1.0, 0.9)
    return (
        span - back * (0.40 * chord + knobs)[:, None],
        span + back * (0.60 * chord + waves)[:, None],
        side * up,
        _curve(t, [0.0, 0.2, 0.6, 0.9, 1.0], [0.018, 0.017, 0.0145, 0.0075, 0.002]),
    )


def _fluke(side: float, t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the left (side 1) or right (-1) half of the flukes: swept, S-shaped and serrated behind."""
    knots = [0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0]
    leading = _curve(t, knots, [0.893, 0.899, 0.916, 0.943, 0.977, 1.017, 1.043])
    trailing = _curve(t, [0.0, 0.04, *knots[1:]], [0.990, 1.014, 1.028, 1.035, 1.032, 1.029, 1.039, 1.050])
    teeth = 0.0020 * np.sin(56.0 * t) + 0.0014 * np.sin(87.0 * t + 1.0 + side)
    trailing = trailing + teeth * smoothstep(t, 0.05, 0.2) * smoothstep(t, 1.0, 0.9)
    x, y = side * (0.008 + 0.158 * t), 0.010 + 0.004 * t * t
    return (
        np.stack([x, y, 0.5 - leading], axis=-1),
        np.stack([x, y, 0.5 - trailing], axis=-1),
        np.broadcast_to([0.0, side, 0.0], (len(t), 3)),
        _curve(t, [0.0, 0.3, 0.7, 1.0], [0.0120, 0.0080, 0.0042, 0.0012]),
    )


def _dorsal(t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the dorsal fin: low, hooked, on a hump."""
    (_, front, _), (_, rear, _) = (body_surface(np.array(s), np.array(0.5 * np.pi)) for s in (0.606, 0.684))
    leading, trailing = (_curve(t, [0.0, 0.5, 1.0], s) for s in ([0.598, 0.640, 0.678], [0.684, 0.677, 0.685]))
    tip, zero = rear + 0.038, np.zeros_like(t)
    return (
        np.stack([zero, front + (tip - front) * t, 0.5 - leading], axis=-1),
        np.stack([zero, rear + (tip - rear) * t, 0.5 - trailing], axis=-1),
        np.broadcast_to([-1.0, 0.0, 0.0], (len(t), 3)),
        _curve(t, [0.0, 0.5, 1.0], [0.016, 0.008, 0.002]),
    )


def _curve(t: Floats, knots: list[float], values: list[float]) -> Floats:
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(knots, values)(t))


_FILLET = {"dorsal fin": 0.7, "left fluke": 0.1, "right fluke": 0.1}
"""Fraction of a fin's length over which the rim of its root becomes its section, where it is not 0.16."""


class _Builder:
    """The body's grid (M, N, 3) of angles (M,) and stations (N,), and the fins that are put on it."""

    def __init__(self, s: Floats, angle: Floats, grid: Floats) -> None:
        self.s, self.angle = s, angle
        sides, rings = grid.shape[:2]
        snout = body_surface(np.zeros(1), np.zeros(1))
        end = body_surface(np.ones(1), np.zeros(1))
        self.positions = [grid.reshape(-1, 3), snout, end]
        self.count = sides * rings + 2
        # Rows around, the first one again at the end; columns from pole to pole
        vertex = np.arange(sides * rings).reshape(sides, rings)
        poles = (np.full((sides + 1, 1), sides * rings + k) for k in (0, 1))
        self.body = np.concatenate([next(poles), vertex[[*range(sides), 0]], next(poles)], axis=1)
        self.drawn = np.ones((sides, rings + 1), bool)
        self.fins: list[Chart] = []
        self.rims: list[NDArray[np.int64]] = []

    def extrude(self, name: str, span: tuple[float, float], angle: float, half: int, fin: Fin, rings: int) -> None:
        """Put a fin in place of the cells between two s and `half` cells to both sides of an angle."""
        # Take away the cells; their rim is the fin's first ring, from the middle of its rear round by the lower row
        first, last = (int(np.argmin(np.abs(self.s - s))) + 1 for s in span)
        middle = round((angle + 0.5 * np.pi) / (2.0 * np.pi) * len(self.angle))
        low, high = middle - half, middle + half
        self.drawn[low:high, first:last] = False
        rim = np.concatenate([
            self.body[middle:low:-1, last], self.body[low, last:first:-1], self.body[low:high, first],
            self.body[high, first:last], self.body[high:middle:-1, last],
        ])  # fmt: skip
        # Further rings are sections of the fin, which near the root keep the rim's offset from the section there
        t = np.arange(rings + 1) / rings
        sections = _sections(*fin(t), len(rim))
        grid = np.concatenate(self.positions)
        fade = 1.0 - smoothstep(t, 0.0, _FILLET.get(name, 0.16))[1:, None, None]
        new = sections[1:] + fade * (grid[rim] - sections[0])
        tip = new[-1].mean(axis=0, keepdims=True)
        vertex = self.count + np.arange(rings * len(rim)).reshape(rings, len(rim))
        self.positions += [new.reshape(-1, 3), tip]
        self.count += rings * len(rim) + 1
        table = np.concatenate([rim[None], vertex, np.full((1, len(rim)), self.count - 1)]).T
        table = np.concatenate([table, table[:1]])
        arc = np.linalg.norm(np.diff(sections[:, [*range(len(rim)), 0]], axis=1), axis=-1).mean(axis=0)
        around = np.concatenate([[0.0], np.cumsum(arc) / arc.sum()])
        place = np.append(t, 1.0 + 0.5 / rings)
        drawn = np.ones((len(rim), rings + 1), bool)
        self.fins.append(Chart(name, table, drawn, place / place[-1], around, np.minimum(place, 1.0)))
        self.rims.append(rim)

    def skin(self) -> WhaleSkin:
        """Return the closed skin, smooth where fins begin."""
        place = np.concatenate([[0.0], self.s, [1.0]])
        # The head has more of the texture than its length
        weight = 1.0 + 0.8 * smoothstep(0.5 * (place[1:] + place[:-1]), 0.30, 0.22)
        along = np.concatenate([[0.0], np.cumsum(weight * (np.diff(place) + 0.0005))])
        around = np.linspace(0.0, 1.0, len(self.angle) + 1)
        charts = [Chart("body", self.body, self.drawn, along / along[-1], around, place), *self.fins]
        skin = WhaleSkin(np.concatenate(self.positions), tuple(charts))
        return replace(skin, positions=_relaxed(skin, np.concatenate(self.rims)))


def _sections(leading: Floats, trailing: Floats, up: Floats, thickness: Floats, count: int) -> Floats:
    """Return rings (k, count, 3) of a fin, from the trailing edge by the lower side to the leading edge and back.

    The edges and sections are those of a `Fin`.
    """
    angle = 2.0 * np.pi * np.arange(count) / count
    chord = 0.5 * (1.0 + np.cos(angle))
    # Half thickness of the NACA four-digit sections, closed behind
    half = 5.0 * (0.2969 * np.sqrt(chord) - 0.1260 * chord - 0.3516 * chord**2 + 0.2843 * chord**3 - 0.1036 * chord**4)
    across = thickness[:, None] * -np.sign(np.sin(angle)) * half
    line = leading[:, None] + (trailing - leading)[:, None] * chord[:, None]
    return np.asarray(line + across[..., None] * up[:, None])


def neighbour_means(faces: NDArray[np.int64], count: int) -> csr_matrix:
    """Return the matrix (count, count) that gives a vertex the mean of its neighbours, or itself where it has none."""
    from scipy.sparse import csr_matrix, diags_array

    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    links = csr_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    links.data[:] = 1.0
    total = np.asarray(links.sum(axis=1)).ravel()
    return csr_matrix(diags_array(1.0 / np.maximum(total, 1.0)) @ links + diags_array((total == 0.0) * 1.0))


_RELAXED = 0.028
"""Distance from the rim of a fin's root up to which the skin is smoothed."""


def _relaxed(skin: WhaleSkin, rims: NDArray[np.int64]) -> Floats:
    """Return vertices (V, 3) moved towards the mean of their neighbours near rims, so that fins grow out smoothly."""
    from scipy.spatial import cKDTree

    positions, means = skin.positions, neighbour_means(skin.faces, len(skin.positions))
    near = smoothstep(cKDTree(positions[rims]).query(positions)[0], _RELAXED, 0.0)[:, None]
    for _ in range(12):
        positions = positions + 0.5 * near * (means @ positions - positions)
    return positions
