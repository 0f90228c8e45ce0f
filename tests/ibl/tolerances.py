# SPDX-License-Identifier: Apache-2.0
"""Tolerances of the light taken from a plate, each with its reason."""

from __future__ import annotations

from tests.tolerances import FLOAT32_TWIN, FLOAT64, GRAVITY_RAD

IRRADIANCE_PEAK = 5e-3
"""Irradiance maps against the integral of the full map, as a share of the peak: light inside a 1.4 degree pixel is
taken to lie at its mean."""
KERNEL_QUADRATURE = 2e-3
"""Constant filters against closed forms: midpoint sums over 4 to 16 samples along a pixel, the kink at the horizon."""
SH9_UNIFORM = 1e-3
"""Nine harmonics of a linear ramp, which they hold exactly, summed over 64 x 32 pixels."""
GLOSSY_PEAK = 2e-2
"""GGX levels against a brute-force sum, as a share of the peak."""
SPLIT_SUM_RMS = 2e-2
"""The fitted split sum against its integral, rms over roughness and n.v."""
SPLIT_SUM_GRAZING_RMS = 5e-3
"""The half of it that Fresnel's rise towards grazing makes, and that is all of a dark dielectric's reflection."""
SUN_HDR_DEG = 0.3
"""Direction of an unclipped sun: a fraction of the pixel of a 512-wide map."""
SUN_CLIPPED_DEG = 1.0
"""Direction of a round clipped sun with its glow, 8 bit: outline of the plateau, half a pixel."""
SUN_LOW_DEG = 2.0
"""Direction of a sun 5 degrees high: hills cut into the clipped glow, 4 degrees wide, whose middle then lies higher."""
SUN_ENERGY = 0.1
"""Irradiance of an unclipped sun: what lies under mean plus two deviations stays in the sky."""
ENERGY_FLOAT32 = 1e-4
"""Sums over a map in single precision."""
YUV_MEAN = 1e-2
"""Light from decoded planes against the same frame decoded in full, mean relative difference: chroma at its own
resolution, a polynomial for the transfer curve."""
PRIMARIES_STANDARD = 1e-4
"""Matrices between primaries against the standards' digits, of which there are four."""
PRIMARIES_LIGHT = 2e-2
"""Light of one scene in 10 bit codes of two primaries, mean of each channel: twice what planes cost (`YUV_MEAN`), as each
is a fit to the curve of its own channels."""
PRIMARIES_SUN = 6e-2
"""Light of a clipped sun two pixels wide in the two: its rim, of mixed codes, under a gain of the tenth power."""
PRIMARIES_CODE = 4
"""10 bit codes of a body lit by its own plate: the fit of the transfer curve (0.8 %), and the dither."""
TRACK_RMS_DEG = 0.45
"""A track of 300 frames with 2 degrees of noise: three parameters a coordinate from 150 frames leave 0.35 degrees."""
SUN_POLE_ENERGY = 0.02
"""Irradiance of a strong sun about the pole: 1 % stays in the sky, there as everywhere."""
SUN_LEFT = 3e-3
"""Brightest pixel of 64 x 32 that a sun leaves in the sky, over its radiance: its rim meets samples and pixels unevenly."""
SUN_RADIUS = 0.7
"""Radius of an unclipped disc in pixels of the plate: interpolation blurs its rim by half a pixel, and cuts it there."""
CLOSURE_RATIO = 0.02
"""Direct to diffuse ratio after the closure, measured on the 64 x 32 map it made."""
SOLAR_DEG = 0.02
"""Position of the sun against NREL's algorithm: the short series, and standard air in the refraction."""
HORIZON_DEG = 4.0
"""Tilt found from Snell's window in one frame: waves move its edge by one or two degrees, light from one side by as much."""
TILT_LIGHT = 0.012
"""Irradiance and ambient light of a tilted plate in level axes against the level plate's, as a share of the peak: the
plate is resampled, and the cut between sun and sky, where both the sky and the veil are brightest, falls between other
samples of it. Under an even sky it is 0.002."""
TILT_MAP = 0.03
"""A levelled map of 64 x 32 against a level plate's, mean difference over mean: pixels of 1.4 degrees are turned, which
blurs the ripples of the sand and the edge of the window."""
ACCELEROMETER = 3e-4
"""Direction of a reading of 4090 steps of 16 bits, rounded."""
WINDOW_EDGE = 3e-2
"""Ratio of two solid angles of Snell's window with a sharp edge in 256 rows: half a row, 0.35 degrees, is up to 1.5 % of
each."""
WIDE_SUN_DEG = 0.02
"""Direction of an unclipped disc of any size: the centroid of covered pixels, of 0.7 degrees at most."""
WIDE_SUN_ENERGY = 5e-3
"""Irradiance of the same above an even sky: the sky's own gradient under the disc."""
WIDE_SUN_RADIUS = 0.2
"""Radius of the same in pixels of the plate: what its covered rim pixels leave, and one below a pixel has its diagonal."""
GLOW_DEG = 2.5
"""Direction of a sun behind clipped clouds by the sky's glow: steps of 0.6 degrees, clouds over a third of the sky."""
STEADY_DEG = 0.7
"""One sun from two seconds of waves of 1.2 degrees: the longest of them, of 3 s, does not average out."""
STEADY_PATH_DEG = 0.8
"""The path of a turning camera through the same waves: those of 3 s are slower than what is smoothed away."""
GLITTER_DEG = 0.3
"""The middle of a clipped glow: the share of it that Snell's window and the patch cut off, half a pixel of 0.7 degrees."""
RATIO_EXPOSURE = 1.5
"""Ratio of direct to diffuse light told from one sky exposed ten times as long: half a stop, as what clips leaves the sky
darker against the ground."""
RATIO_OF_DISC = 0.1
"""The ratio of a sun whose disc alone is clipped: the ground's brightest tenth and the sky about the disc are means over
pixels of 1.4 degrees. By the glow, which there is none of, it was four times too small."""
SUN_COLOR = 0.035
"""Sunlight by one wavelength a channel against its spectrum, of luminance 1: the narrow band cannot follow the blue
that is all but gone at 5 degrees."""
TRACKED_SHARE = 0.02
"""Share of a sun's light over a clip of one picture, and the light with it: the spot is measured about its middle in a
frame, and about the direction of the track in a clip."""

FILLED_OF_ONE_COLOUR = 0.01
"""Filled light over that before clipping: means of pixels about the limit hold some that are clipped already."""
FILLED_COLOUR = 0.12
"""Logarithm of blue over green in filled light from above, over the true one: this water gets paler upwards by as much,
which nothing below the clipped part shows."""
FILLED_WHITE = 1e-6
"""Grey light: the three channels are alike to rounding."""
