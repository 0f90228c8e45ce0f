# SPDX-License-Identifier: Apache-2.0
"""Every tolerance of the tests, with its reason. Each area keeps its own block; no test types a number of its own."""

from __future__ import annotations

# --- arithmetic ------------------------------------------------------------------------------------------------
FLOAT64 = 1e-12
"""Closed forms evaluated in double precision: a few hundred roundings."""
TRANSFER_JOIN = 4e-5
"""Transfer curves there and back: the published break points of sRGB and BT.709 meet to about this, not exactly."""
FLOAT32_TWIN = 2e-5
"""A pure GLSL function against its float64 twin: single precision and the driver's sin, cos, exp (4 ulp each)."""
FLOAT32_LOOKUP = 3e-4
"""A table lookup in GLSL against its float64 twin: a coordinate that is off by 1e-6 of the table times its slope."""

# --- light from the plate --------------------------------------------------------------------------------------

# --- sea and caustics ------------------------------------------------------------------------------------------

# --- water -----------------------------------------------------------------------------------------------------

# --- objects and compositing -----------------------------------------------------------------------------------

# --- video -----------------------------------------------------------------------------------------------------
VIDEO_CURVE_TABLE = 5e-6
"""Transfer curves as tables of 8192 samples over [-1, 2] in single precision: h^2 f''/8 = 6e-8, the knee of sRGB 2e-6."""
VIDEO_SWSCALE = 2.5
"""8-bit codes against FFmpeg's accurate conversion, which rounds chroma and the result to 8 bits (half a code each,
times up to 1.86 in the matrix) and sites chroma between the columns."""
VIDEO_OPAQUE_CODES = 1
"""Chroma codes of an object over two different plates: the dither meets values that differ by single precision."""
VIDEO_DITHER_MEAN = 0.01
"""Mean of some thousand dithered pixels: the noise is even to 1 % of a code there."""

# --- whole frames ----------------------------------------------------------------------------------------------
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
