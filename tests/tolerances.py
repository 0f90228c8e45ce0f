# SPDX-License-Identifier: Apache-2.0
"""Tolerances that tests of several folders or of whole frames share, each with its reason; every folder has its own."""

from __future__ import annotations

from mr360uw.composite.gl.self_test import CODES as RENDERERS_CODES
from mr360uw.composite.gl.self_test import FRACTION as RENDERERS_FRACTION
from mr360uw.composite.gl.self_test import PSNR_DB as RENDERERS_PSNR_DB

FLOAT64 = 1e-12
"""Closed forms evaluated in double precision: a few hundred roundings."""
TRANSFER_JOIN = 4e-5
"""Transfer curves there and back: the published break points of sRGB and BT.709 meet to about this, not exactly."""
WIDE_ROUND_TRIP = 1e-6
"""Curves of HDR television and log recordings there and back: their constants are published with 6 to 10 digits."""
DLOG_JOIN = 1e-4
"""D-Log there and back: the published pieces of its two directions change over at 0.0078 and at 0.14, which is 0.1399."""
FLOAT32_TWIN = 2e-5
"""A pure GLSL function against its float64 twin: single precision and the driver's sin, cos, exp (4 ulp each)."""
FRESNEL_TWIN = 1e-4
"""Fresnel's equations in single precision: near grazing and near the edge of Snell's window the cosine on the other side is
the root of a difference, which loses half of the digits of what is left of it."""
FLOAT32_LOOKUP = 3e-4
"""A table lookup in GLSL against its float64 twin: a coordinate that is off by 1e-6 of the table times its slope."""
PLANE_SLACK_M = 1e-5
"""How far something may reach beyond the planes that enclose it: less than a pixel of a map along the beam."""
GAIN = 0.02
"""A gain found again in a plate with 15 % of noise in every pixel, by medians over a hundred or two of them."""
GAIN_OF_DIVE = 0.03
"""Level light of a dive's water read through 8-bit video: what the project asks."""
GAIN_OF_CLEAR = 0.05
"""The same in clear water, where waves mirror sunlit sand into the band: 4.5 % is found in the blue of type IB."""
CHROMA_STEP = 1.1 / 255.0
"""Half a step of Cb or Cr of 8-bit video as blue or red code (1.06 or 0.9): codecs leave no dither in even water."""
GAIN_FLICKER = 0.05
"""Change of a clip's gain from frame to frame over that of gains fitted to each frame alone."""
FLOAT32 = 2e-6
"""A handful of operations in single precision on numbers near 1 (1e-7 each)."""
MAP_RATIO = 0.003
"""Ratio on a distance map of a plane, coarser than the frame, against the plane: one-sided differences at the horizon."""
BETWEEN_SWEEPS = 0.005
"""Ambient light on level ground between the samples of the device: `ground_light.TOLERANCE`, a code value at most."""
FRAME_ALONE_CODES, FRAME_ALONE_FRACTION = 2.0, 0.99
"""A frame as linear light against the same in a video: light from decoded planes and the dither of the codes; at the
edges of objects the video's chroma is a mean of four pixels."""
HALF_FLOAT = 1e-3
"""Half floats keep 11 bits: 5e-4 of a value near 1."""
GRAIN_TEXTURED = 0.15
"""The same where texture covers half of the frame: what is left of it between the smoothest blocks."""
GRAIN_ADDED = 0.06
"""Standard deviation of grain in some 1e4 chroma samples, clipped and rounded to codes."""
AGREEMENT_PSNR_DB = 45.0
"""gl against the reference on whole frames: single precision, and edge samples that fall on the other side."""
AGREEMENT_CODE = 2.0
"""8-bit code values that agree; see AGREEMENT_FRACTION."""
AGREEMENT_FRACTION = 0.999
"""Part of the samples that agree: the rest lie on edges of triangles, where one ray of a pixel decides."""
ROLL_CODE = 1.0
"""8-bit code values after a yaw: the environment map is sampled between other pixels."""
ROLL_FRACTION = 0.999
"""Part of the samples within ROLL_CODE."""
GRAVITY_RAD = 5e-5
"""Roll and pitch from unit vectors in 16 bits: half a step of 1/32767, over the cosine of the other angle."""
SUN_PLACE = 2e-3
"""Direction of a given sun: the example's rounded digits, and the minute of the equinox' noon."""
DIVE_SUN_SHARE = 0.01
"""The sun's part of the light in the picture: pixels of 0.7 degrees, and the water's own glow above the camera."""
DIVE_WHITE = 0.03
"""Colour of all light just below the surface: the first 5 cm of water take red, and add blue to what they mirror."""
HELD = 0.05
"""A card of the sand's albedo on the sand of a dive, mean in each channel: what the project asks."""
HELD_DARK = 0.15
"""The same in channels of a few codes, where half a code in sky and sand is more than a tenth of their light."""
WATER_ADDS_UP = 5e-3
"""Ambient light and beam from tables over depth, linear between 256 nodes in single precision, against the solved sum."""
COLOUR_OF_FLOOR = 0.02
"""The same over a floor 3 m below: its light enters as three numbers, each with the spectrum of daylight within its wide
channel. Red is 1 % off, green and blue 0.1 %."""
DIVE_FLOOR = 5e-3
"""Irradiance of the dive's floor against the field solved with twice its 32 streams."""
DIVE_SAND = 0.08
"""Sand in the lowest row, a metre across, against the mean of all sand: ripples are 10 % high and patches as wide."""
YUV_NEAREST = 3.5e-4
"""Light of a table of 8192 steps read without interpolation: half a step times the steepest slope, 2.4, is 1.5e-4; the
matrix between primaries, whose first row has absolute values of sum 2.3, makes it up to 3.4e-4."""
YUV_NEAREST_WIDE = 4e-3
"""The same of curves that hold light above white, relative: half a step times the steepest slope of log light, 9 of
S-Log3 and up to 14 of HLG, is 9e-4, the matrix between primaries makes it up to 3e-3."""
YUV_POLYNOMIAL = 1e-2
"""Light by the polynomial of degree 6, relative, above a code value of 0.1: it is fitted to 0.8 %."""
THIN_WATER = 0.2
"""How far the sun's change [log] under 1 cm and 3 cm of water is from proportional to the depth: it is 1 - exp(-20 Kd d)
times that in deep water, and 20 Kd d is up to 0.5 for 3 cm of a harbour's: 17 % below proportional to 1 cm."""
LIT, LIT_FLOOR = 0.05, 0.02
"""Mean light of bodies and of the floor about them over that of path tracing: what the project asks."""
LIT_AWAY = 0.08
"""The same of sides away from the sun and of umbras, whose light is all ambient; the shadow of the light that the water
turns by a few degrees is a Gaussian, and tails of the true one reach into umbras."""
LIT_TURBID = 0.09
"""The same in water whose light turns four times on its way: towards and away from the sun the veil is the azimuth's
mean, and of the blur small angles alone are exact."""
LIT_SIGMAS = 3.0
"""Standard errors of the traced light that are allowed besides."""
RENDERERS_ON_DIVES = 0.012
"""Means over regions by both renderers: where shade begins on a faceted ball, a shadow map and rays differ."""
SPREAD = 0.12
"""Standard deviation of 400 draws, over its own: 1/sqrt(2 x 400), three times."""
