# SPDX-License-Identifier: Apache-2.0
"""Small plots of results: in notebooks by themselves, and as axes of matplotlib.

A result that can be shown derives from `Shown` and says what it looks like as a `Figure`: curves over one axis, or a
picture. A notebook gets that as SVG, without any other package; `show` draws it with matplotlib, `pip install
'mr360uw[plot]'`.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import encode
from mr360uw.errors import ParameterError, needed

__all__ = ["Figure", "Shown", "show"]

_WIDTH, _HEIGHT, _MARGIN = 360, 180, 54
"""Pixels of a plot in a notebook, and of the margin for the figures of an axis."""
_MOST_ACROSS = 512
"""Most pixels across a picture in a notebook: every n-th is shown of larger ones."""
_COLOURS = {"red": "#d62728", "green": "#2ca02c", "blue": "#1f77b4"}
_OTHERS = ("#0b6e99", "#c2410c", "#4d7c0f", "#9467bd", "#8c564b")


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """Look of a result: curves or a picture.

    title: what is shown. x: (n,) of all curves; x_label, y_label: quantity and unit. curves: (n,) by name, NaN where
    there is nothing. image: (h, w, 3) linear light, or (h, w), white 1, instead of curves.
    """

    title: str
    x: ArrayLike = ()
    curves: dict[str, Any] = field(default_factory=dict)
    x_label: str = ""
    y_label: str = ""
    image: ArrayLike | None = None


class Shown:
    """Base of results with a plot."""

    __slots__ = ()

    def _figure(self) -> Figure:
        """Return what the result looks like."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """Return the result's line and its plot, as a notebook shows them."""
        return f"<div><code>{html.escape(repr(self))}</code><br/>{_svg(self._figure())}</div>"


def show(result: Shown, axes: Any = None) -> Any:
    """Draw a result with matplotlib.

    For a quick look; notebooks show the same by themselves. Pictures are drawn as sRGB. For figures of one's own take
    the arrays.

    Parameters
    ----------
    result : Water, Sensor, Environment, Surface, SurfacePicture, CausticStack or ClipAnalysis
        What is drawn.
    axes : matplotlib.axes.Axes, optional
        Where; new ones without.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, for labels and limits of one's own.

    Raises
    ------
    ParameterError
        If the result has no plot, or matplotlib is not installed.

    See Also
    --------
    uw.datasets.of_water : Arrays with units, which xarray plots.
    uw.datasets.of_caustics : Statistics of caustics.

    Examples
    --------
    >>> axes = uw.plot.show(uw.medium.Water.jerlov("IB"))
    >>> axes.get_xlabel()
    'wavelength [nm]'
    """
    # Check the result and the axes, or make axes
    if not isinstance(result, Shown):
        raise ParameterError(f"result - has no plot (got {type(result).__name__}) - see uw.plot.show")
    if axes is None:
        axes = needed("matplotlib.pyplot", "plot", "plot").figure().add_subplot()
    if not hasattr(axes, "set_title"):
        raise ParameterError(f"axes - are none of matplotlib's (got {type(axes).__name__}) - leave them out")
    # Draw a picture or the curves
    figure = result._figure()
    axes.set_title(figure.title)
    if figure.image is not None:
        axes.imshow(_codes(figure.image))
        return axes
    for name, values in figure.curves.items():
        axes.plot(np.asarray(figure.x), np.asarray(values), label=name, color=_COLOURS.get(name))
    axes.set_xlabel(figure.x_label)
    axes.set_ylabel(figure.y_label)
    axes.legend()
    return axes


def _codes(image: ArrayLike) -> NDArray[np.uint8]:
    """Return linear light as 8-bit sRGB (h, w, 3)."""
    light = np.asarray(image, np.float64)
    light = np.repeat(light[..., None], 3, axis=-1) if light.ndim == 2 else light
    return np.asarray(np.round(255.0 * encode(np.clip(light, 0.0, 1.0), "srgb")), np.uint8)


def _svg(figure: Figure) -> str:
    """Return a figure as HTML: curves as SVG, a picture as PNG within it."""
    # Embed a picture as PNG, thinned out
    if figure.image is not None:
        import cv2

        codes = _codes(figure.image)
        step = -(-codes.shape[1] // _MOST_ACROSS)
        data = base64.b64encode(bytes(cv2.imencode(".png", codes[::step, ::step, ::-1])[1])).decode("ascii")
        return f'<img alt="{html.escape(figure.title)}" width="{_WIDTH}" src="data:image/png;base64,{data}"/>'
    curves = [(name, y, False) for name, y in figure.curves.items()]
    return svg_plot(figure.x, curves, f"{figure.y_label} over {figure.x_label}", size=(_WIDTH, _HEIGHT))


def svg_plot(
    x: ArrayLike,
    curves: Sequence[tuple[str, ArrayLike, bool]],
    label: str,
    cuts: Sequence[float] = (),
    unit: str = "",
    size: tuple[int, int] = (900, 200),
) -> str:
    """Return curves (name, y, as dots) over x as an HTML figure of an inline SVG; gaps where y is not finite.

    cuts: places of lines upright. unit: of x, after its figures. size: width and height in pixels.
    """
    # Find the range of the axes, with a rim above and below the curves
    x, (width, height) = np.asarray(x, np.float64), size
    columns = [np.asarray(y, np.float64) for _, y, _ in curves]
    finite = np.concatenate([c[np.isfinite(c)] for c in columns] + [np.zeros(0)])
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    pad = 0.06 * (high - low) or 0.5
    low, high = low - pad, high + pad
    left, right = (float(x[0]), float(x[-1])) if len(x) > 1 else (0.0, 1.0)

    def place(px: NDArray[np.float64], py: NDArray[np.float64]) -> NDArray[np.float64]:
        across = _MARGIN + (px - left) / (right - left) * (width - _MARGIN - 10)
        return np.stack([across, 10 + (high - py) / (high - low) * (height - 40)], axis=-1)

    # Draw the grid with its numbers, and lines at cuts
    out = [f'<svg viewBox="0 0 {width} {height}" width="{width}" role="img" aria-label="{html.escape(label)}">']
    for value in np.linspace(low + pad, high - pad, 3):
        y = place(np.array([left]), np.array([value]))[0, 1]
        out.append(f'<path d="M{_MARGIN} {y:.1f}H{width - 10}" stroke="#e3e9ee"/>')
        out.append(f'<text x="{_MARGIN - 6}" y="{y + 4:.1f}" font-size="11" text-anchor="end">{value:.4g}</text>')
    for value in np.linspace(left, right, 5):
        px, words = place(np.array([value]), np.array([low]))[0, 0], f"{value:.4g} {unit}".strip()
        out.append(f'<text x="{px:.1f}" y="{height - 12}" font-size="11" text-anchor="middle">{words}</text>')
    for cut in cuts:
        px = place(np.array([cut]), np.array([low]))[0, 0]
        out.append(f'<path d="M{px:.1f} 10V{height - 30}" stroke="#9aa7b2" stroke-dasharray="4 3"/>')
    # Draw each curve as dots, or as lines between its gaps
    colours = [_COLOURS.get(name, _OTHERS[k % len(_OTHERS)]) for k, (name, _, _) in enumerate(curves)]
    for (_, _, dots), column, colour in zip(curves, columns, colours, strict=True):
        points, good = place(x, column), np.isfinite(column)
        if dots:
            marks = "".join(f"M{px:.1f} {py:.1f}h.01" for px, py in points[good])
            out.append(f'<path d="{marks}" stroke="{colour}" stroke-width="3" stroke-linecap="round" opacity=".45"/>')
        else:
            runs = np.split(np.flatnonzero(good), np.flatnonzero(np.diff(np.flatnonzero(good)) > 1) + 1)
            lines = "".join("M" + "L".join(f"{px:.1f} {py:.1f}" for px, py in points[run]) for run in runs if len(run))
            out.append(f'<path d="{lines}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
    out.append("</svg>")
    # Name the curves below the plot
    signs = [("\u2022" if dots else "\u2014") + " " + html.escape(name) for name, _, dots in curves]
    key = "\u2002".join(
        f'<span style="color:{colour}">{sign}</span>' for colour, sign in zip(colours, signs, strict=True)
    )
    return f"<figure>{''.join(out)}<figcaption>{html.escape(label)}: {key}</figcaption></figure>"
