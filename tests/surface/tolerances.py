# SPDX-License-Identifier: Apache-2.0
"""Tolerances of pictures through the surface, each with its reason."""

from __future__ import annotations

from tests.tolerances import FLOAT64

PRINTED_FRESNEL = 1e-6
"""Fresnel's equations in sines and tangents: what the project asks; differences of angles round at 1e-15."""
ENERGY = 1e-6
"""Fluxes as sums over directions, the edge of Snell's window between two panels: what the project asks."""
GRAZING = 1e-10
"""Solid angles there and back at grazing angles: the cosine of 1e-3 is the root of a difference of 1e-6."""
SPLINE_HEIGHT_M = 1e-6
"""Cubic splines through twelve points or more to the shortest wave of 1 mm, and Newton's method."""
ON_SURFACE_M = 1e-8
"""A hit over the surface, and the place that Newton's method finds for it: 1e-12 of the tile and of the ray."""
WINDOW_EDGE_PIXELS = 1.0
"""Edge of Snell's window: what the project asks."""
APPARENT_DEPTH = 0.002
"""What the project asks."""
DRAWN_SLOPES = 0.03
"""Mean of 2e5 random slopes over a standard deviation, and their covariance: 0.3 % by chance, and tails cut at 8."""
FACET_LIGHT = 0.01
"""What a ray sees of facets, against a sum over slopes: cells of 0.06 standard deviations."""
SUN_BY_CHANCE = 0.05
"""Radiance of a sun 0.05 wide by random facets: some thousand of 1e5 send it, 3 % by chance, and its image is taken as a
Gaussian."""
SKY_SUM = 1e-9
"""The sky's light as a soft part and bright patches: rounding."""
SKY_RAYS = 4e-3
"""The soft sky's pattern by 4096 rays to a pixel, against as many others: each is off by 0.2 % at 5 m."""
EVEN_SKY = 0.03
"""A floor under a level sea and an even sky: the dome's map of 32 rows, and patches whose maps are even."""
COARSE_SUN = {16: 0.4, 256: 0.1}
"""A sun of a pixel or less falls on one sample, sometimes on none or two: rows are narrower at 50 degrees. One of seven
pixels across has an edge of whole pixels."""
EVEN_PIXEL = 0.12
"""The same in single pixels under waves: they focus the sky's light by some per cent."""
SOLVED = 0.02
"""Light on a floor by tables of the water against the solved field itself."""
SINGLE = 1e-6
"""Values up to 1 of tables in single precision: some roundings of 6e-8."""
HALVED = 1e-6
"""Normals of facets of which one side is found by 24 bisections of 16 standard deviations of 0.2."""
SHADOW_STEP = 0.05
"""Least step of a ray towards the sun over the distance of pixels: it may pass through the tip of a ridge there."""
AROUND_SUN = 0.015
"""Veil times its map about the sun against the field at an azimuth: tables in the gamut, mixed over depths, and a map of
1.4 degrees."""
TWICE_THROUGH = 5e-3
"""Light that goes from the floor to the surface and back: 16 streams, and the edge of Snell's window between two of them."""
OF_SHAPE = 5e-3
"""A sky of 64 rows by means over steps of the sine of 1/16: a row near the horizon is 0.05 wide."""
