# SPDX-License-Identifier: Apache-2.0
"""Tolerances of sea and caustics, each with its reason."""

from __future__ import annotations

from tests.tolerances import FLOAT32, FLOAT32_LOOKUP, FLOAT32_TWIN, FLOAT64, PLANE_SLACK_M

SNELL_ROUND_TRIP = 1e-7
"""Into water and back at grazing angles: the cosine is the root of a difference, which keeps half of the digits."""
SKY_REFLECTANCE = 5e-5
"""Published to four decimals."""
PRINTED_INDEX = 6e-5
"""Indices printed to four decimals."""
FINITE_DIFFERENCE = 1e-6
"""Central differences over 1e-5 m: the third derivative times 1e-10, and roundings of 1e-16/1e-5."""
TILE_EDGE = 1e-9
"""Opposite edges of a tile, both ends of a loop: phases of a few hundred radians, rounded."""
FFT_SUM = 1e-10
"""A fast transform against the direct sum: roundings of some 1e4 waves."""
STATED_HEIGHT = 0.02
"""Four standard deviations of one sea over one tile against the stated height."""
SPECTRUM_PEAK = 1e-3
"""The highest sample of a spectrum that is sampled every 3e-4 rad/s."""
SPREAD_INTEGRAL = 5e-5
"""Trapezoidal rule with 2e4 samples over a function with a cusp where waves run against the wind."""
SHALLOW_LIMIT = 1e-6
"""tanh(x) against x at x = 1e-3: x^2/3 and a root."""
TOTAL_SLOPE = 0.05
"""Mean square slope of one moment against that of another: waves of one sea meet in other phases."""
DETAIL_STRENGTH = 0.15
"""Bilinear samples between texels of a wavy map lose some of its variance."""
CAUSTICS_MEAN_REFERENCE = 1e-6
"""Energy of a map in double precision."""
COVERAGE_TWIN = 5e-4
"""Intensity of a cell in single precision: flux over an area of 2e-3 pixel^2 or more, whose corners are rounded to 1e-7."""
ENOUGH_CELLS = 0.05
"""RMSE over standard deviation that the default grid is chosen for."""
CAUSTICS_TRUTH = {"calm": 0.007, "choppy": 0.02}
"""RMSE over standard deviation against a photon map, grid 256 and map 128: 0.0046 and 0.015. A cell's light is even
inside each of its two triangles; the light over an area is exact, whatever the map. Dividing areas is off by 0.046."""
CAUSTICS_TRUTH_COARSE = 0.11
"""The same at grid 100: 0.09 for the choppy sea."""
CAUSTICS_AGREEMENT_DISC = 0.03
"""The same with the disc: the renderers blur by a disc and by the product of its two projections, and OpenGL leaves out
discs below a quarter of a pixel."""
SHADOWED_FLUX = 0.025
"""Light through a grid whose triangles are lit by thirds, against rays: cells of 4 to 6 cm at edges of shadows."""
TILT_CONTRAST = 0.1
"""Standard deviation just below the surface, where only the squeezing of particles and their tilt count."""
SHARED_CELL = 1e-9
"""The light of one cell over its pixels: areas of a few thousandths of a pixel divide roundings of 1e-16."""
DISC_SHAPE = 0.03
"""Variance of a sampled disc against radius^2/4, relative: pixels are as wide as the disc."""
BEAM_SHIFT = 2e-3
"""Place [m] of a ripple's light: its flux follows its tilt, which moves the pattern by a millimetre."""
STACK_BETWEEN = {"calm": 0.05, "choppy": 0.12}
"""RMSE over standard deviation of a mix of two planes, 0.4 to 0.8 m apart, against a plane halfway, suns to 40 degrees:
a choppy sea's filaments move by more than their width from plane to plane."""
RANDOM_SLOPES = 0.03
"""Covariance of 4e4 random rays: 1 % by chance, and second order in slopes of 0.01."""
ROUNDED_GAUSSIAN = 0.01
"""A blurred wave: Gaussians are rounded to 1/64 pixel, and sampled where narrow."""
BLURRED_WAVES = 0.35
"""RMSE over standard deviation of a blur against the short waves it stands for, whose own pattern is left."""
EDGE_SUM = 1e-9
"""Light summed along edges against light found pixel by pixel: differences of intensities up to 1e3, in doubles."""
FOOTPRINT_CONTRAST = 0.05
"""Contrast of a lookup against that of the mean over its footprint, whose shape is another. With the level whose pixels
are as wide as the footprint it is 0.2 to 0.3 lower."""
FOOTPRINT_PATTERN = 0.3
"""RMSE over standard deviation of the same: a box and a tent of fixed places are not the box about the point. With the
level whose pixels are as wide as the footprint it is 0.33 to 0.48."""
EVEN_STEPS = 2.0
"""Largest change of light in a step of a rising body over the median one: filaments cross its points unevenly; planes
that move with the body change it by 10 times the median where their number changes."""
SMALLER_MAP_CONTRAST = 0.1
"""Contrast seen through a pixel in the map that is fine enough for it against that in a finer one: see `map_size`."""
TURNED_BALL = 0.02
"""Light on a ball turned onto itself, or seen by a turned camera, over what the caustics change or the brightest light:
rounding of single precision moves samples at edges of triangles; a pattern that turned along would change by 1."""
WORLD_GRID = 0.02
"""Height [m] and normal up to 5 % of a pixel beside its centre: slopes and curvatures of the sea times 6 mm."""
SIXTEEN_BIT = 1e-4
"""Codes of 16 bits, rounded, over the range that a PNG holds."""
SUMMED_POINTS = 2e-5
"""Sums of points in single precision: places in 128 pixels are rounded to 1e-5 of one."""
SUMMED_SHEET = 2e-3
"""Even light of points a third of a pixel apart: bilinear shares leave (sinc 3)^2 of their lattice, 0 but for rounding."""
FOURTH_ORDER = 0.05
"""Error of a cell's mean place over that of straight lines, 32 cells a wave: (k cell)^2 = 0.04 times a number below 1."""
SPECTRUM_VARIANCE = 2e-3
"""Height of a whole spectrum against its closed form: waves shorter than a hundredth of the peak's period are left out,
and those of the shortest have surface tension and, in TMA's factor, a bottom 1000 m deep."""
GROWING_HEIGHT = 0.01
"""Height while a sea grows fully developed, over that: energy of a peak by its sharpness is a fit within a per cent."""
LIKE_SEAS = 1.6
"""Ratio of the slope variance or the caustics' contrast of two kinds of sea of one wind. Slopes of Gerstner waves are even
over log k, those of a spectrum lie about its peak or fall into the part that the tile holds; a sea of the energy that an
endless fetch once had was four times as steep and more."""
PHILLIPS_HELD = 0.03
"""Variance of a spectrum that a lattice holds: sums for integrals, and waves longer or shorter than those."""

SLOPE_ROUNDING = 1e-6
"""Slopes below a flat sea: sums in single precision."""
SLOPE_OF_A_RAY = 4e-4
"""Slopes at places that single rays reach: a pixel of 3 cm is a mean over a hundredth of a wave of 8 m."""
SLOPES_SUMMED = 3e-3
"""RMS of slopes from coarser cells against those of all of them: a tenth of what there is."""
BENT_SHADOW = 0.065
"""RMS of the light at the edge of a shadow against photons in squares of 3 cm: 0.058, of which noise is 0.008."""
