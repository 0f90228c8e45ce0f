# SPDX-License-Identifier: Apache-2.0
"""Every tolerance of the tests, with its reason. Each area keeps its own block; no test types a number of its own."""

from __future__ import annotations

# --- arithmetic ------------------------------------------------------------------------------------------------
FLOAT64 = 1e-12
"""Closed forms evaluated in double precision: a few hundred roundings."""
HULL_SHALLOW = 1.1e-4
"""Part of the extent that points of very large meshes may stand out of their hull (1e-4), and of its rounding."""
TRANSFER_JOIN = 4e-5
"""Transfer curves there and back: the published break points of sRGB and BT.709 meet to about this, not exactly."""
FLOAT32_TWIN = 2e-5
"""A pure GLSL function against its float64 twin: single precision and the driver's sin, cos, exp (4 ulp each)."""
FRESNEL_TWIN = 1e-4
"""Fresnel's equations in single precision: near grazing and near the edge of Snell's window the cosine on the other side is
the root of a difference, which loses half of the digits of what is left of it."""
FLOAT32_LOOKUP = 3e-4
"""A table lookup in GLSL against its float64 twin: a coordinate that is off by 1e-6 of the table times its slope."""
FILTER_WEIGHTS = 8e-3
"""A lookup that graphics hardware filters, of pixels up to 1.5 apart: its weights have 8 bits, so each of the two axes
and levels is off by up to 1/512 of that. Software drivers filter in single precision."""

# --- light from the plate --------------------------------------------------------------------------------------
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
TILT_LIGHT = 0.01
"""Irradiance and ambient light of a tilted plate in level axes against the level plate's, as a share of the peak: the
plate is resampled, and the cut between sun and sky falls between other samples of it."""
TILT_MAP = 0.03
"""A levelled map of 64 x 32 against a level plate's, mean difference over mean: pixels of 1.4 degrees are turned, which
blurs the ripples of the sand and the edge of the window."""

# --- sea and caustics ------------------------------------------------------------------------------------------
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
BLENDED_EDGE = 1e-6
"""Both sides of a blended edge meet up to the last 1e-12 of the tile times the blend's slope."""
STATED_HEIGHT = 0.02
"""Four standard deviations of one sea over one tile against the stated height."""
SPECTRUM_PEAK = 1e-3
"""The highest sample of a spectrum that is sampled every 3e-4 rad/s."""
SPREAD_INTEGRAL = 5e-5
"""Trapezoidal rule with 2e4 samples over a function with a cusp where waves run against the wind."""
SHALLOW_LIMIT = 1e-6
"""tanh(x) against x at x = 1e-3: x^2/3 and a root."""
DETAIL_STRENGTH = 0.15
"""Bilinear samples between texels of a wavy map lose some of its variance."""
CAUSTICS_MEAN_REFERENCE = 1e-6
"""Energy of a map in double precision."""
CAUSTICS_MEAN_GL = 1e-3
"""Energy of a map in single precision, thin triangles at the folds included."""
FLAT_SEA_GL = 2e-5
"""A flat sea's map in single precision: corners in pixels of a few hundred, rounded to 3e-5, over cells of a few."""
COVERAGE_TWIN = 5e-4
"""Intensity of a cell in single precision: flux over an area of 2e-3 pixel^2 or more, whose corners are rounded to 1e-7."""
CAUSTICS_TRUTH = {"calm": 0.02, "choppy": 0.05}
"""RMSE over standard deviation against 1e8 photons, grid 256 and map 512. A cell's light is even inside each of its two
triangles, which a calm sea's smooth pattern shows most."""
CAUSTICS_TRUTH_COARSE = 0.25
"""The same at grid 100."""
CAUSTICS_AGREEMENT = 0.005
"""RMSE over standard deviation between the renderers without the sun's disc: rays near a fold, rounded to 1e-4 pixels,
fall into the next pixel, and the brightest pixels are there."""
CAUSTICS_AGREEMENT_DISC = 0.03
"""The same with the disc: the renderers blur by a disc and by the product of its two projections, and OpenGL leaves out
discs below a quarter of a pixel."""
SAMPLED_AGREEMENT = 0.12
"""Methods that sample triangles at pixel centres: a centre on an edge falls to either side in single precision."""
TILT_CONTRAST = 0.1
"""Standard deviation just below the surface, where only the squeezing of particles and their tilt count."""
SHARED_CELL = 1e-9
"""The light of one cell over its pixels: areas of a few thousandths of a pixel divide roundings of 1e-16."""
DISC_SHAPE = 0.03
"""Variance of a sampled disc against radius^2/4, relative: pixels are as wide as the disc."""
FALSE_COLOUR = 1e-9
"""Three passes with one refractive index are one pass."""
BEAM_SHIFT = 2e-3
"""Place [m] of a ripple's light: its flux follows its tilt, which moves the pattern by a millimetre."""
STACK_BETWEEN = {"calm": 0.05, "choppy": 0.12}
"""RMSE over standard deviation of a mix of two planes, 0.4 to 0.8 m apart, against a plane halfway, suns to 40 degrees:
a choppy sea's filaments move by more than their width from plane to plane."""
EDGE_SUM = 1e-9
"""Light summed along edges against light found pixel by pixel: differences of intensities up to 1e3, in doubles."""
FOOTPRINT_CONTRAST = 0.05
"""Contrast of a lookup against that of the mean over its footprint, whose shape is another. With the level whose pixels
are as wide as the footprint it is 0.2 to 0.3 lower."""
FOOTPRINT_PATTERN = 0.3
"""RMSE over standard deviation of the same: a box and a tent of fixed places are not the box about the point. With the
level whose pixels are as wide as the footprint it is 0.33 to 0.48."""
PLANE_SLACK_M = 1e-5
"""How far something may reach beyond the planes that enclose it: less than a pixel of a map along the beam."""
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

# --- water -----------------------------------------------------------------------------------------------------
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
TABLE_BEAM = 5e-3
"""The sun's beam from a table over its path against sums over wavelength, down to a thousandth of it."""
GREY_OF_OBSERVER = 0.17
"""Grey in the gamut of the observer, faded by lobes: the red that negative responses would take is missing."""
FITTED_MEAN_6, FITTED_P95_12 = 0.012, 0.01
"""Relative colour error of 6 (mean) and 12 (95th percentile) fitted bands over veils in all waters."""
UPSAMPLING = 1e-3
"""The published basis spectra sum to 1 to three decimals."""
UPSAMPLED_COLOUR = 0.02
"""Colour of an upsampled albedo under D65 over 400 to 700 nm: the basis was made over 380 to 780 nm."""
WHITE = 1e-12
"""White maps to (1, 1, 1): a normalised sum."""
PLATE_LEVEL = 1e-6
"""The veil's end equals the plate's profile: radiance and in-scatter are the same sum, far away."""
TABLE_BETWEEN_DEPTHS = 4e-3
"""Tables mixed in a straight line from depths 6 % apart; the curve between is that of the light above the camera."""
GAIN_STEP = 0.3
"""Change of a gain over that of the plate's pixels: 1 where all change alike, less where few do."""
GAIN = 0.02
"""A gain found again in a plate with 15 % of noise in every pixel, by medians over a hundred or two of them."""
GAIN_FLICKER = 0.05
"""Change of a clip's gain from frame to frame over that of gains fitted to each frame alone."""
SERIES = 5e-3
"""First-order expansions compared at one hundredth of an optical length: half of that is left of second order."""

# --- objects and compositing -----------------------------------------------------------------------------------
SMOOTH_NORMALS = 0.002
"""Cosine between the normals of a sphere and those found from a mesh of 24 rows: half a step is 4 degrees at most."""
POLYGON_AREA = 0.01
"""A sphere of 32 rows of flat facets lies inside the round one."""
RECTANGLE_PIXELS = 4
"""A rectangle is one pixel wider than the triangle on every side, which itself may miss pixel centres."""
EDGE_PIXELS = 0.02
"""A place in a frame of 512 columns in single precision, and the arc functions near a pole."""
FLOAT32 = 2e-6
"""A handful of operations in single precision on numbers near 1 (1e-7 each)."""
FURNACE = 0.005
"""A white body in white light vanishes to within half a per cent."""
POLE_AREA = 0.005
"""Area of a body: facets instead of a round sphere, and finitely many samples at its edge."""
ROLL_CODES = 1.0
"""A turn by whole columns moves every sample to another one exactly, but for roundings at edges."""
PENUMBRA = 0.03
"""Sun disc by 96 directions against 1024: about n^-3/4 of the disc."""
OCCLUSION = 0.03
"""32 surfels for a body, their facing averaged, against 4096 rays over the hemisphere."""
MAP_RATIO = 0.003
"""Ratio on a distance map of a plane, coarser than the frame, against the plane: one-sided differences at the horizon."""
QUADRATURE = 0.002
"""A midpoint sum of some hundred to some thousand terms."""
TEXTURE_TWIN = 2e-3
"""Half-float texels between which single precision mixes; coordinates of 3e-7 times 40 texels."""
FRAME_ALONE_CODES, FRAME_ALONE_FRACTION = 2.0, 0.99
"""A frame as linear light against the same in a video: light from decoded planes and the dither of the codes; at the
edges of objects the video's chroma is a mean of four pixels."""
RENDERERS_PSNR_DB = 45.0
"""gl against the reference over a frame: what a compositor does not see in a difference picture."""
RENDERERS_CODES = 2.0
"""8-bit code values that gl may be off by ..."""
RENDERERS_FRACTION = 0.999
"""... in all pixels but one of a thousand: samples that an edge misses by a rounding, texels of the shadow map."""
AOV_DIFFERENCE = 0.02
"""An output variable, gl against the reference: the shadow map's steps where the sun is half covered."""
HALF_FLOAT = 1e-3
"""Half floats keep 11 bits: 5e-4 of a value near 1."""
LOBE_AXIS_DEG = 3.0
"""Fitted direction of a coat's lobe, rms over roughness and n.v: the lobes are 10 to 100 degrees wide."""
ONE_SIDED_METAL = 0.05
"""Rough metal in light of 1 from one side, rms over a ball: filtered maps are round, the lobe is not (0.035; 0.11 with the
mirrored direction)."""
MASK_EDGE_PX = 0.5
"""Where a mask cuts along a row [px]: alpha between texels, a third of a pixel wide here, seen by 17 samples."""
PIXEL_HOLES = 1e-3
"""Coverage inside a closed body: a ray that meets an edge exactly may pass both its triangles."""
ALPHA = 0.02
"""Coverage, gl against the reference: less than one of 29 samples."""

BLOCK_CODES = 10.0
"""Largest error of the ground's pixels, in codes, where a body touches it: a shadow's edge there is as wide as a texel of
the sun map. With corners of blocks alone it is 30 to 100."""
BLOCK_ERROR = 0.12
"""Sum of the errors of the ground's pixels over that of its changes: 0.001 to 0.01 for bodies, 0.05 to 0.09 for balls a few
pixels wide. With corners alone 0.3 and 2."""
EDGE_CODES = 1.2
"""Root mean square error of edge pixels in codes: coverage by 65 samples, times the contrast to the plate, leaves 0.9;
that of 17 leaves 1.8."""
SHADOW_RIM_FRACTION = 0.998
"""Pixels of a 128 x 64 frame within two codes where a wide penumbra on any floor is in view: 14 of its rim are 2 to 4
codes off, on a plane as on a map of it."""
DISTANCE_NORMAL = 2e-4
"""Cosine of normals from a distance map in single precision, 60 m away: differences of 1e-3 of what they are taken of."""
DISTANCE_EDGES = 0.985
"""Texels of a map with a box and a ball whose normals are right to 2 degrees: all but those that an edge crosses, and the
rim of the ball, which curves within a texel."""
ROUNDED_NORMAL_DEG = 3.5
"""Mean error of normals of maps of 8 and 10 bits over the same scene: 9 to 21 degrees as they are."""

# --- video -----------------------------------------------------------------------------------------------------
VIDEO_CURVE_TABLE = 5e-6
"""Transfer curves as tables of 8192 samples over [-1, 2] in single precision: h^2 f''/8 = 6e-8, the knee of sRGB 2e-6."""
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
GRAIN_TEXTURED = 0.15
"""The same where texture covers half of the frame: what is left of it between the smoothest blocks."""
GRAIN_CORRELATION = 0.06
"""Correlation of neighbouring pixels of noise made to a measured spectrum, filter cut at 5 pixels."""
GRAIN_VARIANCE = 0.02
"""Variance and mean of some 1e5 samples, correlated over a few pixels."""
GRAIN_ADDED = 0.06
"""Standard deviation of grain in some 1e4 chroma samples, clipped and rounded to codes."""
GRAIN_MEAN_CODES = 0.1
"""Mean of grain of 4 codes over the same samples."""
GRAIN_SPECTRUM = 0.07
"""Mean of the power over 63 x 63 frequencies: four standard deviations."""
GRAIN_DITHER_CODES = 0.25
"""Dither of a gradient has the variance that is taken off, 1/6, to a third over the blocks of one brightness."""

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
SUN_PLACE = 2e-3
"""Direction of a given sun: the example's rounded digits, and the minute of the equinox' noon."""

# --- the sample dive -------------------------------------------------------------------------------------------
DIVE_SUN_SHARE = 0.01
"""The sun's part of the light in the picture: pixels of 0.7 degrees, and the water's own glow above the camera."""
DIVE_WHITE = 0.03
"""Colour of all light just below the surface: the first 5 cm of water take red, and add blue to what they mirror."""
