# SPDX-License-Identifier: Apache-2.0
"""Tolerances of video, each with its reason."""

from __future__ import annotations

from tests.tolerances import FLOAT32, GRAIN_ADDED, GRAIN_TEXTURED

VIDEO_CURVE_TABLE = 5e-6
"""Transfer curves as tables of 8192 samples over [-1, 2] in single precision: h^2 f''/8 = 6e-8, the knee of sRGB 2e-6."""
VIDEO_PQ_SATURATED = 5e-3
"""Share of codes of a strongly coloured PQ picture that change by a round trip through float32 light in Rec.709: PQ has
codes for light 1e-6 of white, where the other channels are above 10 and single precision ends at 1e-6."""
VIDEO_WIDE_TABLE = 1e-4
"""The same, relative, for curves that rise to 49 times white: h^2/8 times 14^2 is 3e-6, and the matrix between primaries
takes differences of numbers up to five times as large."""
VIDEO_SWSCALE = 2.5
"""8-bit codes against FFmpeg's accurate conversion, which rounds chroma and the result to 8 bits (half a code each,
times up to 1.86 in the matrix) and sites chroma between the columns."""
VIDEO_OPAQUE_CODES = 1
"""Chroma codes of an object over two different plates: the dither meets values that differ by single precision."""
VIDEO_SEAM_CODES = 2
"""Chroma codes at the first column of a tile, where the change to the left is taken to equal its own: an eighth of the
plate's step between two chroma samples (here 4 codes), and the dither."""
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
GRAIN_STD = 0.08
"""Standard deviation found: medians of 16 blocks a brightness leave 3 %, the lowest frequencies taken like their
neighbours 5 % of grain that is blurred by a pixel."""
GRAIN_CORRELATION = 0.06
"""Correlation of neighbouring pixels of noise made to a measured spectrum, filter cut at 5 pixels."""
GRAIN_VARIANCE = 0.02
"""Variance and mean of some 1e5 samples, correlated over a few pixels."""
GRAIN_MEAN_CODES = 0.1
"""Mean of grain of 4 codes over the same samples."""
GRAIN_SPECTRUM = 0.07
"""Mean of the power over 63 x 63 frequencies: four standard deviations."""
GRAIN_DITHER_CODES = 0.25
"""Dither of a gradient has the variance that is taken off, 1/6, to a third over the blocks of one brightness."""
VIDEO_SHARED_EXPONENT = 1 / 128
"""Radiance pictures keep 8 bits, cut off, of channels that share the exponent of the largest: a step is 1/256 to 1/128 of it."""
VIDEO_LUT = 1e-4
"""Values through a lookup table and back, and light of a table against the formula that it samples: planes are decoded
in single precision, and colour-science's text has seven digits."""
VIDEO_LUT_LINE = 2.5e-7
"""Values of 0 to 1 through a table that is a line: OpenColorIO computes in single precision, 2 steps of 1.2e-7."""
VIDEO_LUT_CODES = 1
"""Codes of a body by a table and by the curve that it samples: the dither meets values that differ by VIDEO_LUT."""
VIDEO_OCIO = 5e-3
"""Light by OpenColorIO's config of ACES against our matrices, over the brightest: it goes through another white, by CAT02
in and by Bradford out, which differ by 0.4 % in blue."""
VIDEO_PRORES_CODES = 4e-3
"""Flat areas of ProRes 4444 in 10 bits: a code of luma and of chroma, 1/876 and 1/896 times up to 1.86, and its quantiser."""
GRAIN_BELOW_BLACK = -0.02
"""Light of dark codes under grain of 24 to 32 codes: luma of each pixel beside chroma that is interpolated between
samples whose grain the darkest pixel of each bounds. Without the bound, -0.5."""
PROFILE = 2e-4
"""Light of a profile: its numbers are rounded to 1/65536, published matrices to 1e-4 of white."""
JPEG_CODES = 2.0
"""Half of all codes after a JPEG of quality 95 of smooth colours."""
LOSSY = 0.03
"""Fraction of white: formats that lose, at their best quality."""
RGBE = 4e-3
"""Mantissas of 8 bits that share an exponent: 1/256 of the brightest channel."""
HALF = 2e-3
"""Relative: numbers of 11 bits in products and differences of three channels; degrees in single precision."""
