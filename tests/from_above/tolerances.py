# SPDX-License-Identifier: Apache-2.0
"""Tolerances of pictures from above, each with its reason."""

from __future__ import annotations

APPARENT_DEPTH = 0.002
"""What the project asks."""
FORMULA = 1e-3
"""Koschmieder's formula through tables of the water, which are right to 0.1 %."""
SINGLE = 1e-6
"""Pictures are in single precision."""
START_M = 1e-5
"""Rays start a micrometre off the surface, in water of metres."""
SKY_SUM = 1e-9
"""Sums over a dome's pixels: rounding."""
ZENITH = 1e-4
"""A sun that rounding puts 1e-16 off the zenith: corners of the surface's cells that lie on edges of the map's pixels
fall to either side."""
JOINED = 0.01
"""Tables of one light read at the nodes of another's, both bilinear."""
