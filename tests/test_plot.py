# SPDX-License-Identifier: Apache-2.0
"""Results in a notebook: one line, and a plot that a browser can read."""

from __future__ import annotations

import base64
import re
from xml.etree import ElementTree as ET

import cv2
import matplotlib as mpl
import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.color import encode
from mr360uw.plot import Shown
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.surface import SurfacePicture

SEA = uw.caustics.GerstnerSea(wave_count=4)
SETTINGS = uw.caustics.CausticSettings(size=16, grid=16)
MASK = np.ones((2, 4), np.bool_)
PIXELS = np.linspace(0.0, 1.0, 24).reshape(2, 4, 3)
RESULTS: dict[str, Shown] = {
    "water": uw.medium.Water.jerlov("IB"),
    "sensor": uw.medium.Sensor.cie1931(),
    "environment": uw.ibl.environment(np.full((32, 64, 3), 0.3)),
    "surface": SEA.grid_surface(8, 0.0),
    "points of a surface": SEA.surface([0.0, 1.0], [0.0, 0.0], 0.0),
    "caustics": uw.caustics.caustic_stack(SEA, [0.0, 1.0, 0.0], [1.0, 4.0], 0.0, SETTINGS),
    "picture": SurfacePicture(PIXELS, PIXELS[..., 0], PIXELS[..., 0], PIXELS, MASK, MASK, True),
    "analysis": ClipAnalysis(gain=np.linspace(1.0, 2.0, 9).reshape(3, 3)),
    "nothing measured": ClipAnalysis(),
}  # fmt: skip


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_shows_itself(name: str) -> None:
    line, page = repr(RESULTS[name]), RESULTS[name]._repr_html_()
    assert len(line) < 160
    assert "\n" not in line
    assert line[1:-1].replace("<", "&lt;").replace(">", "&gt;") in page
    ET.fromstring(page)


def test_the_picture_in_a_notebook_is_the_result_s() -> None:
    found = re.search(r"base64,([^\"]+)", RESULTS["picture"]._repr_html_())
    assert found
    codes = cv2.imdecode(np.frombuffer(base64.b64decode(found[1]), np.uint8), cv2.IMREAD_COLOR_RGB)
    white = float(np.quantile(PIXELS, 0.99))
    expected = np.round(255.0 * encode(np.clip(PIXELS / white, 0.0, 1.0), "srgb"))
    np.testing.assert_array_equal(codes, expected)


def test_axes_of_matplotlib_have_the_curves() -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    axes = uw.plot.show(RESULTS["analysis"])
    np.testing.assert_array_equal(axes.lines[1].get_ydata(), [1.125, 1.5, 1.875])
    assert uw.plot.show(RESULTS["caustics"], axes) is axes
    assert len(axes.images) == 1
    plt.close("all")
    with pytest.raises(uw.ParameterError, match="result - has no plot"):
        uw.plot.show(1.0)  # type: ignore[arg-type]
