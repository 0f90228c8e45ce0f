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
CLOSED_FORM_FLOAT32 = 1e-5
"""The closed form in single precision against 50-digit arithmetic: a dozen roundings and exp of arguments up to 80."""
FLOAT32_SMALLEST = 1e-37
"""Radiances below cannot be held in single precision."""
PHASE_NORM = 2e-3
"""Phase functions with a forward peak, integrated by a quadrature of their own: Petzold's peak holds 5 % below 0.1 deg."""
PETZOLD_MOMENTS = 5e-4
"""Published mean cosine 0.924 and bb/b 0.0183 of Petzold's average particle: three figures."""
INSCATTER_ISOTROPIC = 0.004
INSCATTER_PEAKED = 0.02
"""Rms of (in-scatter - truth)/total radiance over the reference rows, isotropic and Henyey-Greenstein or Petzold: what
the project asks of its solver; 32 streams a hemisphere reach a tenth of it."""
IRRADIANCE = 5e-3
"""Relative error of irradiances against the reference rows; the solver reaches 2e-4."""
GERSHUN = 1e-4
"""Energy: divergence of the net irradiance against absorption, by a central difference over 2 mm."""
ANALYTIC_FIELD = 1e-9
"""The identity of the radiance along a ray holds to rounding; its terms cancel at small distances."""
PICTURE_PEAKED = 0.07
PICTURE_ISOTROPIC = 0.10
"""Whole path-traced pictures, rms of the difference over rms of the picture per wavelength: 0.025 is their own noise, the
rest that an endless ocean stands for one with a floor, and that scattering by small angles blurs nothing."""
TABLE_MEAN, TABLE_P95 = 1e-3, 5e-3
"""Interpolated tables against direct sums over 61 bands, relative to the largest channel: what the project asks."""
FITTED_MEAN_6, FITTED_P95_12 = 0.012, 0.01
"""Relative colour error of 6 (mean) and 12 (95th percentile) fitted bands over veils in all waters."""
WHITE = 1e-12
"""White maps to (1, 1, 1): a normalised sum."""
PLATE_LEVEL = 1e-6
"""The veil's end equals the plate's profile: radiance and in-scatter are the same sum, far away."""
GAIN = 0.02
"""A gain found again in a plate with 15 % of noise in every pixel, by medians over a few hundred of them."""
SERIES = 5e-3
"""First-order expansions compared at one hundredth of an optical length: half of that is left of second order."""

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
VIDEO_PICTURE_CODES = 3.3
"""R'G'B' of an 8-bit picture through 8-bit Y'CbCr 4:4:4: dithered by less than a code, hence 255/219 of luma and
1.86 x 255/224 of chroma at most."""
VIDEO_MEMORY_GROWTH = 0.05
"""Peak memory of ten times the frames: the index of packets and the allocator's luck."""
VIDEO_LOSSY_MEAN = 0.02
"""Mean light of a small clip through lossy codecs at the quality of their defaults."""
VIDEO_CODE_LIGHT = 0.012
"""Light of one 8-bit code next to white: 1/219 times the slope 2.3 of sRGB, dithered up or down by less than a code."""

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
