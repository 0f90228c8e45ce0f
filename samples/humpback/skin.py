# SPDX-License-Identifier: Apache-2.0
"""Markings of the whale: maps of colour, roughness and normals, painted over the charts of its skin.

What has a place on the animal (the border of the pale belly, mouth, eyes) is a function of points of the surface, and
is therefore the same on both sides of a seam. Heights of pleats, tubercles and folds are in body lengths and become
the map of normals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shape import EYE, Chart, WhaleSkin, above_lips, profile

from mr360uw.base.texels import smoothstep
from mr360uw.types import Floats

_ATLAS = {
    "body": (0.0, 0.0, 1.0, 0.605),
    "left pectoral": (0.0, 0.61, 0.44, 0.80),
    "right pectoral": (0.0, 0.805, 0.44, 0.995),
    "left fluke": (0.445, 0.61, 0.80, 0.80),
    "right fluke": (0.445, 0.805, 0.80, 0.995),
    "dorsal fin": (0.805, 0.61, 1.0, 0.80),
}
"""Rectangles of the charts on the maps: left, top, right, bottom, in widths of the map."""
_MARGIN = 1.0 / 512.0
"""Width of the rim around a chart that repeats its edge, for lookups in coarse levels of the maps."""


def map_coordinates(chart: Chart) -> Floats:
    """Return texture coordinates (R, C, 2) of a chart's vertices, right and down from the top left of the maps."""
    left, top, right, bottom = _ATLAS[chart.name]
    u = left + _MARGIN + (right - left - 2.0 * _MARGIN) * chart.along
    v = top + _MARGIN + (bottom - top - 2.0 * _MARGIN) * chart.around
    return np.stack(np.meshgrid(u, v), axis=-1)


def painted(skin: WhaleSkin, size: int, seed: int) -> dict[str, bytes]:
    """Return the maps as JPEG, `size` pixels wide and high: colour, roughness (in its green), normals."""
    maps = {
        "colour": np.full((size, size, 3), _BACK, np.float32),
        "roughness": np.full((size, size), 0.5, np.float32),
        "normals": np.tile(np.array([0.0, 0.0, 1.0], np.float32), (size, size, 1)),
    }
    grain = _grain(size, seed)
    for chart in skin.charts:
        texels = _Texels(skin, chart, size, seed, grain)
        coat = (_body_coat if chart.name == "body" else _fin_coat)(texels)
        maps["colour"][texels.window] = np.clip(coat.colour, 0.0, 1.0)
        maps["roughness"][texels.window] = np.clip(coat.roughness, 0.04, 1.0)
        maps["normals"][texels.window] = _normals(coat.height, texels)
    maps["normals"] = 0.5 + 0.5 * maps["normals"]
    return {name: _jpeg(values, *_QUALITY[name]) for name, values in maps.items()}


_QUALITY = {"colour": (88, 0x221111), "roughness": (80, 0x221111), "normals": (88, 0x111111)}
"""Quality and subsampling of chroma of the JPEGs: normals keep all of it."""


def _jpeg(values: NDArray[np.float32], quality: int, sampling: int) -> bytes:
    import cv2

    codes = np.round(255.0 * values).astype(np.uint8)
    codes = codes[..., ::-1] if codes.ndim == 3 else codes
    settings = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    settings += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling] if codes.ndim == 3 else []
    return bytes(cv2.imencode(".jpg", codes, settings)[1])


# ----------------------------------------------------------------------------------------------------------- the texels


class _Texels:
    """The h x w texels of a chart and its margin.

    chart; window: rows and columns of the maps; points: (h, w, 3) of the surface; place, around: (w,) s or fraction of
    a fin's length, (h,) fraction of the way around; step: (2, h, w) body lengths a texel, to the right and down.
    grain: speckles, mottles and streaks (h, w) of standard deviation 1; seed: of all marks.
    """

    def __init__(
        self, skin: WhaleSkin, chart: Chart, size: int, seed: int, grain: tuple[NDArray[np.float32], ...]
    ) -> None:
        left, top, right, bottom = (round(size * edge) for edge in _ATLAS[chart.name])
        self.chart, self.seed, self.window = chart, seed, np.s_[top:bottom, left:right]
        self.grain = tuple(one[self.window] for one in grain)
        # Where the centres of texels are between the rows and columns of the chart; the margin repeats its edge
        coordinates = map_coordinates(chart)
        u, v = (np.arange(left, right) + 0.5) / size, (np.arange(top, bottom) + 0.5) / size
        column = np.interp(u, coordinates[0, :, 0], np.arange(len(chart.along)))
        row = np.interp(v, coordinates[:, 0, 1], np.arange(len(chart.around)))
        self.points = _between(_between(skin.positions[chart.vertex].astype(np.float32), row), column, axis=1)
        self.place = _between(chart.place.astype(np.float32), column)
        self.around = (row / (len(chart.around) - 1)).astype(np.float32)
        # Lengths of texels, from the grid: those of an edge that has shrunk to a pole are those nearby
        steps = []
        for axis, knots in ((1, coordinates[0, :, 0]), (0, coordinates[:, 0, 1])):
            rate = np.linalg.norm(np.gradient(skin.positions[chart.vertex], knots, axis=axis), axis=-1) / size
            steps.append(_between(_between(rate.astype(np.float32), row), column, axis=1))
        self.step = np.maximum(np.stack(steps), np.float32(0.1 / size))

    @property
    def rng(self) -> np.random.Generator:
        """Random numbers of the chart's own marks."""
        return np.random.default_rng([self.seed, *self.chart.name.encode()])

    def cloud(self, stream: int, *scales: tuple[float, float]) -> NDArray[np.float32]:
        """Return smooth noise (h, w) in space: a sum over (wavelength in body lengths, amplitude).

        It is the same on both sides of a seam; another stream is other noise.
        """
        import cv2
        from scipy.ndimage import map_coordinates as at

        # Noise varies slowly over texels: one value for four by four is enough
        width, height = self.points.shape[1::-1]
        coarse = cv2.resize(self.points, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
        total = np.zeros(coarse.shape[:2], np.float32)
        rng = np.random.default_rng([self.seed, stream])
        for wavelength, amplitude in scales:
            lattice = rng.standard_normal((32, 32, 32), dtype=np.float32)
            where = np.moveaxis(coarse, -1, 0) * (2.0 / wavelength) + 16.0 * rng.random((3, 1, 1))
            # a cubic spline of independent values has a standard deviation of 1 / 1.7 on average
            total += 1.7 * amplitude * at(lattice, where, np.float32, order=3, mode="grid-wrap", prefilter=False)
        return np.asarray(cv2.resize(total, (width, height), interpolation=cv2.INTER_CUBIC))


def _between(values: NDArray[Any], where: Floats, axis: int = 0) -> NDArray[Any]:
    """Return values at fractional places along an axis, straight between neighbours."""
    first = np.clip(where.astype(np.int64), 0, values.shape[axis] - 2)
    t = (where - first).astype(values.dtype)
    t = t.reshape([-1 if k == axis else 1 for k in range(values.ndim)])
    return np.take(values, first, axis=axis) * (1 - t) + np.take(values, first + 1, axis=axis) * t


def _grain(size: int, seed: int) -> tuple[NDArray[np.float32], ...]:
    """Return grain (size, size) of standard deviation 1: speckles, mottles, and streaks along the body."""
    import cv2

    white = np.random.default_rng(seed).standard_normal((size, size), dtype=np.float32)
    scale = size / 2048.0
    blurred = (
        cv2.GaussianBlur(white, (0, 0), x * scale, sigmaY=y * scale) for x, y in ((1.0, 1.0), (3.5, 3.5), (16.0, 1.2))
    )
    return tuple(grain / grain.std() for grain in blurred)


def _normals(height: NDArray[np.float32], texels: _Texels) -> NDArray[np.float32]:
    """Return unit normals (h, w, 3) of heights: x to the right and y up on the map."""
    down, right = np.gradient(height)
    normals = np.stack([-right / texels.step[0], down / texels.step[1], np.ones_like(height)], axis=-1)
    return (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)


# ------------------------------------------------------------------------------------------------------------- the coat

_BACK = np.array([0.225, 0.252, 0.278], np.float32)
_BELLY = np.array([0.80, 0.80, 0.775], np.float32)
_BLOTCH = np.array([0.36, 0.385, 0.405], np.float32)
_SCAR = np.array([0.62, 0.64, 0.64], np.float32)
_CREASE = np.array([0.055, 0.060, 0.070], np.float32)
_IRIS, _PUPIL = np.array([0.10, 0.075, 0.06], np.float32), np.array([0.012, 0.012, 0.016], np.float32)
"""Colours, sRGB codes over 255."""
_Window = tuple[slice, slice]


@dataclass(slots=True, eq=False)
class _Coat:
    """Maps of a chart while they are painted: colour (h, w, 3) as sRGB, roughness and height (h, w)."""

    colour: Floats
    roughness: Floats
    height: Floats

    def part(self, window: _Window) -> _Coat:
        """Return the coat of a window, which paints on this one."""
        return _Coat(self.colour[window], self.roughness[window], self.height[window])

    def tint(self, color: Floats, weight: Floats) -> None:
        """Mix in a colour by weights (h, w) from 0 to 1."""
        self.colour += weight[..., None] * (color - self.colour)


def _skin_coat(texels: _Texels, paleness: Floats) -> _Coat:
    """Return skin that is dark where `paleness` is well below 0, white with grey blotches where it is well above."""
    speckle, mottle, streak = texels.grain
    # The border is ragged down to flecks
    ragged = texels.cloud(1, (0.22, 0.17), (0.08, 0.12), (0.03, 0.08), (0.013, 0.05))
    pale = smoothstep(paleness + ragged + 0.028 * mottle + 0.012 * speckle, -0.09, 0.13)
    # Dark skin is clouded and dappled; white skin has grey blotches of soft borders
    shade = texels.cloud(2, (0.35, 0.6), (0.13, 0.5), (0.05, 0.4), (0.020, 0.35))
    light = 1.0 + 0.15 * shade + 0.05 * mottle + 0.012 * streak + 0.025 * speckle
    relief = texels.step.min(axis=0) * (0.10 * mottle + 0.03 * streak)
    coat = _Coat(_BACK * light[..., None], 0.48 + 0.03 * shade + 0.015 * mottle, relief)
    white = _BELLY * (1.0 + 0.05 * shade + 0.015 * mottle + 0.006 * streak)[..., None]
    blotch = texels.cloud(3, (0.10, 0.9), (0.035, 0.7), (0.014, 0.45)) + 0.2 * mottle
    white += (0.65 * smoothstep(blotch, 0.8, 2.3))[..., None] * (_BLOTCH * light[..., None] - white)
    coat.colour += pale[..., None] * (white - coat.colour)
    coat.roughness += 0.05 * pale
    return coat


def _height_on_body(s: Floats, y: Floats) -> Floats:
    """Return how high points are on the body's side at s: -1 the belly, 0 the widest, 1 the back."""
    table = np.linspace(0.0, 1.0, 513)
    top, bottom, widest = (
        np.interp(s, table, profile(table, column)).astype(np.float32) for column in ("top", "bottom", "widest")
    )
    above = np.maximum(y - widest, 0.0) / (top - widest)
    return np.asarray(np.clip(above + np.minimum(y - widest, 0.0) / (widest - bottom), -1.2, 1.2))


_BORDER = np.array([(0.0, -0.25), (0.1, -0.40), (0.25, -0.35), (0.35, -0.25), (0.5, -0.45), (0.65, -0.75), (0.8, -0.95),
                    (0.9, -0.6), (1.0, -0.4)])  # fmt: skip
"""(s, height on the body) of the border between the dark back and the pale belly."""


def _body_paleness(s: Floats, y: Floats) -> Floats:
    return np.interp(s, _BORDER[:, 0], _BORDER[:, 1]).astype(np.float32) - _height_on_body(s, y)


def _body_coat(texels: _Texels) -> _Coat:
    """Return the body's coat."""
    s, points = texels.place[None, :], texels.points
    coat = _skin_coat(texels, _body_paleness(s, points[..., 1]))
    _pleats(coat, texels)
    # Only the head has mouth, blowholes and eyes
    head = np.s_[:, : int(np.searchsorted(texels.place, 0.26))]
    x, y, _ = np.moveaxis(points[head], -1, 0)
    for paint in (_mouth, _blowholes, _eyes):
        paint(coat.part(head), s[head], x, y)
    rng = texels.rng
    _scars(coat, texels, 70, rng)
    _tubercles(coat, texels, rng)
    _barnacles(coat, texels, _barnacle_places(texels, rng), rng)
    return coat


def _fin_coat(texels: _Texels) -> _Coat:
    """Return the coat of a fin: at its root that of the body, dark above and pale below."""
    chart, points = texels.chart, texels.points
    paleness = _body_paleness(0.5 - points[..., 2], points[..., 1])
    if chart.name == "dorsal fin":
        return _skin_coat(texels, paleness)
    # Rows begin at the trailing edge, and go around by the lower side of a left fin, by the upper one of a right fin
    turn, t = 2.0 * np.pi * texels.around[:, None], texels.place[None, :]
    below = np.sin(turn) * (1.0 if chart.name.startswith("left") else -1.0)
    # White reaches over the leading edge of pectorals; flukes are dark along all their edges
    rear, front = np.maximum(np.cos(turn), 0.0) ** 12, np.maximum(-np.cos(turn), 0.0) ** 12
    if "pectoral" in chart.name:
        reach = 0.25 * front - 0.30 * rear + 0.25 * t
    else:
        reach = -0.55 * (front + rear) - 0.35 * smoothstep(t, 0.5, 1.0)
    paleness = paleness + smoothstep(t, 0.0, 0.2) * (0.6 * (below - 0.3 + reach) - paleness)
    coat, rng = _skin_coat(texels, paleness), texels.rng
    _scars(coat, texels, 12, rng)
    _barnacles(coat, texels, _edge_places(texels, rng), rng)
    return coat


def _pleats(coat: _Coat, texels: _Texels) -> None:
    """Cut the throat pleats: grooves from the chin to the navel, each of its own length."""
    window = np.s_[:, : int(np.searchsorted(texels.place, 0.6))]
    s, coat = texels.place[None, window[1]], coat.part(window)
    # Angle from the middle of the belly, and the number of grooves up to there, which waver a little
    away = 360.0 * np.minimum(texels.around, 1.0 - texels.around)[:, None]
    number = np.maximum(
        away / _PLEAT_DEG + 0.10 * texels.cloud(4, (0.2, 1.0), (0.06, 0.5))[window] * smoothstep(away, 0.0, 9.0), 0.0
    )
    which = number.astype(np.int32)
    # Grooves are longest in the middle, and stop below the mouth and the pectorals
    random = np.random.default_rng([texels.seed, 5]).random((2, 64), dtype=np.float32)
    begin, end = 0.012 + 0.03 * random[0][which], (0.56 - 0.05 * random[1])[which] - 0.22 * (away / _PLEATED_DEG) ** 3
    depth = (
        smoothstep(s - begin, 0.0, 0.02)
        * smoothstep(end - s, 0.0, 0.05)
        * smoothstep(away, _PLEATED_DEG, _PLEATED_DEG - 4.0)
    )
    depth = depth * smoothstep(-above_lips(np.minimum(s, 0.2), texels.points[window][..., 1]), 0.004, 0.012)
    # 0 in the middle of a ridge, 1 in the groove
    groove = depth * (2.0 * np.abs(number - which - 0.5)) ** 6
    coat.height -= 0.0022 * groove
    coat.colour *= 1.0 - 0.6 * (groove**1.5)[..., None]
    coat.roughness += 0.15 * groove


_PLEAT_DEG, _PLEATED_DEG = 5.2, 78.0
"""Angle about the body between grooves, and from the middle of the belly to the last one."""


def _mouth(coat: _Coat, s: Floats, _: Floats, y: Floats) -> None:
    """Cut the line between the lips, which are worn pale along it."""
    over = above_lips(s, y)
    there = smoothstep(s, 0.245, 0.230)
    coat.height -= 0.0022 * there * smoothstep(s, 0.0, 0.02) * np.exp(-((over / 0.0015) ** 2))
    coat.tint(_CREASE, 0.85 * there * np.exp(-((over / 0.0012) ** 2)))
    coat.tint(_SCAR, 0.10 * there * np.exp(-(((np.abs(over) - 0.004) / 0.002) ** 2)))


def _blowholes(coat: _Coat, s: Floats, x: Floats, y: Floats) -> None:
    """Cut two slits that part towards the rear, behind their guard."""
    along = np.clip((s - 0.193) / 0.019, 0.0, 1.0)
    away = np.hypot(np.abs(x) - 0.0030 - 0.0050 * along, s - 0.193 - 0.019 * along)
    there = smoothstep(y, 0.0, 0.02)
    slit = there * np.exp(-((away / 0.0017) ** 2))
    coat.height += there * 0.0012 * np.exp(-(((away - 0.0040) / 0.0022) ** 2)) - 0.0030 * slit
    coat.tint(0.6 * _CREASE, slit)


def _eyes(coat: _Coat, s: Floats, _: Floats, y: Floats) -> None:
    """Paint eyes: a dark, wet ball in an almond between lids, and a fold above."""
    right, up = (s - EYE[0]) / 0.0056, (y - EYE[1]) / 0.0030
    # Distance from the middle that is 1 on the rim of the almond
    rim = np.sqrt(up**2 + 0.2 * right**2) + 0.8 * right**2 / (1.0 + right**2)
    inside = smoothstep(rim, 1.08, 0.92)
    lids, fold = np.exp(-(((rim - 1.5) / 0.35) ** 2)), np.exp(-(((rim - 2.7) / 0.45) ** 2)) * smoothstep(up, 0.2, 1.4)
    coat.height += 0.0009 * lids - 0.0004 * fold - 0.0005 * np.exp(-(((rim - 1.02) / 0.15) ** 2))
    coat.tint(_BLOTCH, 0.35 * lids)
    coat.tint(_CREASE, 0.35 * fold)
    coat.tint(_IRIS, inside)
    ball = np.hypot(s - EYE[0], y - EYE[1]) / 0.0022
    coat.tint(_PUPIL, inside * smoothstep(ball, 1.05, 0.85))
    coat.height += 0.0008 * inside * np.maximum(1.0 - 0.5 * ball**2, 0.0)
    coat.roughness += inside * (0.1 - coat.roughness)


# ------------------------------------------------------------------------------------------------------------ the marks


def _scars(coat: _Coat, texels: _Texels, count: int, rng: np.random.Generator) -> None:
    """Scratch the skin: single scars, and rows of parallel ones as teeth leave them."""
    import cv2

    h, w = texels.points.shape[:2]
    mask = np.zeros((h, w), np.uint8)
    for _ in range(count):
        # Choose place, length, direction and bend; one in eight is a row of scars
        row, column = rng.random(2) * (h, w)
        j, i = int(row), int(column)
        length, angle = 0.006 + 0.05 * rng.random() ** 2, rng.normal(0.0, 0.7)
        bend, weight, teeth = rng.normal(0.0, 0.3), rng.uniform(0.2, 0.9), 1
        if rng.random() < 0.12:
            length, teeth = length + 0.012, int(rng.integers(3, 6))
        # Draw parabolas beside one another, in body lengths and then in texels there
        t = np.linspace(-0.5, 0.5, 9)
        for tooth in range(teeth):
            right = length * (t * np.cos(angle) - bend * t**2 * np.sin(angle)) - 0.0026 * tooth * np.sin(angle)
            down = length * (t * np.sin(angle) + bend * t**2 * np.cos(angle)) + 0.0026 * tooth * np.cos(angle)
            line = np.stack([column + right / texels.step[0, j, i], row + down / texels.step[1, j, i]], axis=-1)
            cv2.polylines(mask, [np.round(16.0 * line).astype(np.int32)], False, round(255 * weight), 1, cv2.LINE_AA, 4)
    # Pale them and sink them into the skin
    mask = cv2.GaussianBlur(mask, (0, 0), 0.8).astype(np.float32) / 255.0
    coat.tint(_SCAR, 0.75 * mask)
    coat.height -= 0.0003 * mask


_Spot = tuple[float, float, float]
"""A round mark: its row and column of texels, and its radius in body lengths."""


def _around_spot(texels: _Texels, spot: _Spot, reach: float) -> tuple[tuple[slice, slice], Floats]:
    """Return the window of texels within `reach` radii of a spot, and their distances from it in radii."""
    (h, w), (row, column, radius) = texels.points.shape[:2], spot
    j, i = min(int(row), h - 1), min(int(column), w - 1)
    right, down = radius / texels.step[:, j, i]
    rows = np.arange(max(int(row - reach * down), 0), min(int(row + reach * down) + 2, h))
    columns = np.arange(max(int(column - reach * right), 0), min(int(column + reach * right) + 2, w))
    away = np.hypot((rows[:, None] + 0.5 - row) / down, (columns[None, :] + 0.5 - column) / right)
    return np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], away


def _at(texels: _Texels, s: float, degrees: float) -> tuple[float, float]:
    """Return (row, column) of the body's texel at s and an angle from the back [deg], positive to the right."""
    row = np.interp(0.5 + degrees / 360.0, texels.around, np.arange(len(texels.around)) + 0.5)
    return float(row), float(np.interp(s, texels.place, np.arange(len(texels.place)) + 0.5))


def _tubercles(coat: _Coat, texels: _Texels, rng: np.random.Generator) -> None:
    """Raise the tubercles of the head: three rows on the rostrum, one along each lip of the lower jaw."""
    places = [(s, 0.0) for s in np.linspace(0.030, 0.165, 7)]
    for side in (-1.0, 1.0):
        places += [(s, side * (66.0 - 40.0 * s)) for s in np.linspace(0.018, 0.175, 11)]
        places += [(s, side * 36.0) for s in np.linspace(0.05, 0.15, 5)]
        places += [(s, side * (112.0 + 20.0 * s)) for s in np.linspace(0.02, 0.16, 10)]
        places += [(s, side * 150.0) for s in np.linspace(0.015, 0.035, 2)]
    for s, degrees in places:
        row, column = _at(texels, s + rng.normal(0.0, 0.002), degrees + rng.normal(0.0, 2.5))
        window, away = _around_spot(texels, (row, column, rng.uniform(0.0042, 0.0062)), 1.0)
        dome = np.maximum(1.0 - away**2, 0.0) ** 2
        there = coat.part(window)
        there.height += rng.uniform(0.0022, 0.0032) * dome
        there.tint(_SCAR, 0.16 * dome)


def _barnacle_places(texels: _Texels, rng: np.random.Generator) -> list[_Spot]:
    """Return spots of barnacles on the body: on the chin and lips, few elsewhere."""
    spots = []
    for s, degrees, spread, count in (
        (0.02, 150.0, 14.0, 16), (0.02, -148.0, 14.0, 14), (0.07, 118.0, 8.0, 6), (0.09, -118.0, 8.0, 7),
        (0.25, 130.0, 20.0, 5), (0.5, 175.0, 20.0, 6), (0.62, 0.0, 12.0, 4),
    ):  # fmt: skip
        for _ in range(count):
            row, column = _at(texels, abs(s + rng.normal(0.0, 0.012)) + 0.004, degrees + rng.normal(0.0, spread))
            spots.append((row, column, rng.uniform(0.0016, 0.0034)))
    return spots


def _edge_places(texels: _Texels, rng: np.random.Generator) -> list[_Spot]:
    """Return spots of barnacles along the leading edge of a fin, and near its tip."""
    h, w = texels.points.shape[:2]
    spots = []
    for _ in range(26):
        row = h * (0.5 + rng.normal(0.0, 0.025))
        spots.append((row, w * rng.uniform(0.12, 0.9), rng.uniform(0.0014, 0.0028)))
    return spots


def _barnacles(coat: _Coat, texels: _Texels, spots: list[_Spot], rng: np.random.Generator) -> None:
    """Set barnacles, some of which have fallen off and left a pale ring."""
    for spot in spots:
        gone = rng.random() < 0.45
        window, away = _around_spot(texels, spot, 1.4)
        there, ring = coat.part(window), np.exp(-(((away - 0.72) / 0.26) ** 2))
        there.tint(_SCAR, (0.55 if gone else 0.8) * ring)
        if not gone:
            there.tint(_CREASE, np.exp(-((away / 0.32) ** 2)))
            there.height += 0.0013 * ring
            there.roughness += 0.4 * smoothstep(away, 1.1, 0.8)
