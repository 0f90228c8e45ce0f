# SPDX-License-Identifier: Apache-2.0
"""Small plots of results: in notebooks by themselves, and as axes of matplotlib.

A result that can be shown derives from `Shown` and says what it looks like as a `Figure`: curves over one axis, or a
picture. A notebook gets that as SVG, without any other package; `show` draws it with matplotlib, `pip install
'mr360uw[plot]'`.
"""

from __future__ import annotations

import base64
import html
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import encode
from mr360uw.errors import ParameterError, install_command, optional

_WIDTH, _HEIGHT, _MARGIN = 360, 180, 34
"""Pixels of a plot in a notebook, and of the margin for its axes' figures."""
_MOST_ACROSS = 512
"""Most pixels across a picture in a notebook: every n-th is shown of larger ones."""
_COLOURS = {"red": "#d62728", "green": "#2ca02c", "blue": "#1f77b4"}
_OTHERS = ("#1f77b4", "#ff7f0e", "#9467bd", "#8c564b", "#17becf")


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
        try:
            axes = optional("matplotlib.pyplot").figure().add_subplot()
        except ImportError:
            raise ParameterError(f"plot - needs matplotlib (got none) - {install_command('plot')}") from None
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
    # Find the range of the axes
    x = np.asarray(figure.x, np.float64)
    finite = [y[np.isfinite(y)] for y in (np.asarray(y, np.float64) for y in figure.curves.values())]
    values = np.concatenate([*finite, np.zeros(1)])
    low, high, left, right = values.min(), values.max(), x.min(initial=np.inf), x.max(initial=-np.inf)
    across, up = _WIDTH - 2 * _MARGIN, _HEIGHT - 2 * _MARGIN
    parts = [f'<rect x="{_MARGIN}" y="{_MARGIN}" width="{across}" height="{up}" fill="none" stroke="#999"/>']

    def text(at_x: float, at_y: float, words: str, colour: str = "#666", anchor: str = "middle") -> None:
        parts.append(f'<text x="{at_x:g}" y="{at_y:g}" fill="{colour}" text-anchor="{anchor}">{words}</text>')

    # Draw each curve with its name, then the axes' figures
    for number, (name, curve) in enumerate(figure.curves.items()):
        colour = _COLOURS.get(name, _OTHERS[number % len(_OTHERS)])
        y = np.asarray(curve, np.float64)
        there = np.isfinite(y)
        px = _MARGIN + across * (x[there] - left) / max(right - left, 1e-300)
        py = _MARGIN + up * (high - y[there]) / max(high - low, 1e-300)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        text(_MARGIN + 4 + 60 * number, _MARGIN - 4, html.escape(name), colour, "start")
    text(_MARGIN, _HEIGHT - 20, f"{left:.4g}")
    text(_WIDTH - _MARGIN, _HEIGHT - 20, f"{right:.4g}")
    text(_WIDTH / 2, _HEIGHT - 6, html.escape(figure.x_label))
    text(_MARGIN - 3, _MARGIN + 8, f"{high:.3g}", anchor="end")
    text(_MARGIN - 3, _HEIGHT - _MARGIN, f"{low:.3g}", anchor="end")
    text(_WIDTH - _MARGIN, _MARGIN - 4, html.escape(figure.y_label), anchor="end")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{_HEIGHT}" font-size="10" '
        f'font-family="sans-serif">{"".join(parts)}</svg>'
    )
