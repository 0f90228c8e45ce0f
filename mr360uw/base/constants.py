# SPDX-License-Identifier: Apache-2.0
"""Physical and colorimetric constants, each defined once.

`gl/__init__.py` writes the upper-case numbers of this module into the shaders as `constants.glsl`.
"""

from __future__ import annotations

import math

PI = math.pi
INV_PI = 1.0 / math.pi
INV_4PI = 0.25 / math.pi

REFRACTIVE_INDEX_SEA = 1.34
"""Refractive index of sea water relative to air, mean of the visible (Quan & Fry 1995)."""

SUN_HALF_ANGLE_RAD = 0.00465
"""Mean angular radius of the solar disc seen from the Earth, above the surface."""

GRAVITY_M_S2 = 9.80665
"""Standard gravity (CGPM 1901)."""

SURFACE_TENSION_OVER_DENSITY = 7.3e-5
"""Surface tension over density of sea water, m^3/s^2."""

MEAN_COSINE_SEA = 0.90
"""Mean cosine g of the volume scattering phase function where none is given (Petzold 1972: 0.87 to 0.92)."""

LUMINANCE_R, LUMINANCE_G, LUMINANCE_B = 0.2126, 0.7152, 0.0722
"""Luminance of linear Rec.709 primaries (ITU-R BT.709-6)."""

CLEAR_SKY_R, CLEAR_SKY_G, CLEAR_SKY_B = 0.82, 1.03, 1.25
"""Colour of a clear sky relative to sun and sky together, linear Rec.709: near CIE daylight of 9000 K over D65."""

NEAREST_LAMP_M = 1e-3
"""Least distance [m] from a point lamp: bounds the inverse square."""

MINIMUM_SUN_UP = 0.05
"""Least sine of the sun's elevation in the water: the path of a horizontal beam would be infinite."""

LONGEST_RAY_M = 1e9
"""Stands for an infinite ray through water, so that no infinity meets a zero."""

BRIGHTEST_LOG = 40.0
"""Greatest log ratio of the light at a depth to that at the camera (2e17), so that products stay finite in single
precision. Light that is so much brighter than at the camera does not reach it."""

BRIGHTEST = 64.0
"""Most light that lamps and bodies that shine add on the ground, as a multiple of the plate's own: past six stops its
noise is what would be seen."""
DARK = 1e-9
"""Least irradiance in ratios of light, which bounds them in the dark."""

GAMUT_THRESHOLD = 0.9
GAMUT_POWER = 1.2
"""Threshold of the compression of out-of-gamut colours (distance from the largest channel), and its sharpness."""

DITHER_ALONG, DITHER_DOWN, DITHER_CONTRAST = 0.06711056, 0.00583715, 52.9829189
"""Interleaved gradient noise frac(contrast frac(along x + down y)) of pixels (Jimenez 2014)."""
DITHER_STEP, DITHER_FRAMES = 5.588238, 64
"""Columns and rows by which its pattern moves from frame to frame, and frames after which it begins again."""
DITHER_LEAST = 0.001
"""Distance of the dither from 0 and from 1, so that rounding errors alone change no code."""

ENVIRONMENT_ROWS = 32
ENVIRONMENT_COLUMNS = 64
"""Size of the environment maps."""

MAXIMUM_SUN_SAMPLES = 32
"""Most directions over a light's disc."""

MAXIMUM_GLOSSY_LEVELS = 8
"""Most roughnesses that the environment is filtered at: the length of the shaders' array of them."""

LONGEST_FOOTPRINT = 16.0
"""Longest side of a pixel on a slanted surface, over its width across the ray, for means of shadows: that of a pixel
3.6 degrees below the horizon of a floor. Twice as large: smoother shadows towards the horizon, more bodies to test."""
JUST_BELOW_M = 0.01
"""Depth [m] at which rays that come from the surface start: a medium's camera is in the water."""

DEPTH_FRAME_S, DEPTH_EYES_S = 1.4, 7.0
"""Time [s] that `mr360uw depth` takes on two cores for a frame of 1024 columns, and for both eyes of one of 2048."""

CLIPPED_LIGHT = 0.97
"""Light from which a channel of a plate that ends at white is clipped: the last few codes."""
MOST_LIGHT = 1e9
"""Most linear light of a plate's sample, either way: a thousand times the sun's disc beside a white that is 1. Sums
over a frame stay finite in single precision."""
