# SPDX-License-Identifier: Apache-2.0
"""Tolerances of the water, each with its reason."""

from __future__ import annotations

from tests.tolerances import FLOAT32, FLOAT32_LOOKUP, FLOAT64, GAIN

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
QUADRATURE_OF_STREAMS = 1e-5
"""Irradiances of uniform light behind an absorber, by 32 directions a hemisphere against exponential integrals."""
TRACED, TRACED_SIGMAS = 3e-4, 4.0
"""Path-traced light over a floor, 48 values: what the solver's streams miss, and standard errors of the value."""
AROUND_SUN = 3e-3
"""Radiance by its azimuth from the sun against path tracing, beside its noise: 32 directions a hemisphere and ten orders
of cos(m azimuth) against 160 and 28: 0.1 % rms at a mean cosine of 0.924, 0.3 % for Petzold's function."""
AROUND_ALL_BANDS, GROWTH_AROUND_SUN = 5e-3, 0.05
"""Light by azimuth from every fourth wavelength, between depths of a factor of 1.4, against all at the depth itself; and
on rays of 3 m with the ratio of endless ones, in clear water, of the light of the ray itself: red upwards is 4 % off."""
HARMONIC = 1e-3
"""What is known is found again up to the smoothing over half a pixel, which moves light about the sun by 3e-4."""
H_FUNCTIONS = 1e-6
"""Radiance of deep water by 32 directions a hemisphere against Chandrasekhar's exact reflection."""
SLAB_RADIANCE, SLAB_SMOOTH_RADIANCE, SLAB_IRRADIANCE = 1e-3, 3e-5, 1e-6
"""Slabs by 32 directions a hemisphere against another solver's with 96 to 200 in all: radiance over the largest of the
slab, irradiance over the incident one. Under a slant beam with a forward peak, what is asked, where orders of the azimuth
are left out (6e-4 is found); else ten times what is found, 3e-6 and 1e-7, most of it rounding of the values."""
PRINTED_RADIANCE, PRINTED_IRRADIANCE = 5e-6, 1e-5
"""Six printed figures, made with as many streams; Haze L's with 16 a hemisphere and rounded moments: 9e-6 is found."""
AZIMUTH_ORDERS = 4e-3
"""Light about a sun without negligible orders against all of them, at most 0.15 % of the light there; with ten orders
27 % under a sun just above the edge of the window."""
WINDOW_RADIANCE = 4e-3
"""Light of a uniform sky by 32 directions against 96, of the largest of each wavelength: 0.2 %; 2 % by 16."""
MEAN_OF_AZIMUTHS = 2e-3
"""Radiances at 64 azimuths against the mean over them, whose forward peak is summed over other nodes."""
SCATTERED_ONCE = 2e-3
"""Water of a scattering of 1e-4/m: light that is scattered twice has a share of that order."""
BEAM_STREAMS = 0.015
"""Radiance under a beam by 32 directions a hemisphere against 96: 0.2 % at a mean cosine of 0.924, 1.4 % at 0.95, all of
it in light straight back along a high beam; without exact single scattering it is 7 and 40 %."""
GERSHUN = 1e-4
"""Energy: divergence of the net irradiance against absorption, by a central difference over 2 mm."""
ANALYTIC_FIELD = 1e-9
"""The identity of the radiance along a ray holds to rounding; its terms cancel at small distances."""
PICTURE_PEAKED = 0.07
PICTURE_ISOTROPIC = 0.10
"""Whole path-traced pictures, rms of the difference over rms of the picture per wavelength: 0.023 and 0.03 are their own
noise, the rest that five large bodies keep light from the water about them, and that small angles blur nothing here."""
TABLE_MEAN, TABLE_P95 = 1e-3, 5e-3
"""Interpolated tables against direct sums over 61 bands, relative to the largest channel: what the project asks."""
DRAFT_TABLE = 3.0
"""Errors of tables for drafts over these: half as many nodes each way, where errors of straight lines grow fourfold."""
TABLE_SHALLOW = 0.035
"""The same where rays just above the level end after tens of metres, from 0.3 m: rows of the table 1 degree apart."""
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
TABLE_BETWEEN_DEPTHS = 4e-3
"""Tables mixed in a straight line from depths 6 % apart; the curve between is that of the light above the camera."""
GAIN_STEP = 0.3
"""Change of a gain over that of the plate's pixels: 1 where all change alike, less where few do."""
SERIES = 5e-3
"""First-order expansions compared at one hundredth of an optical length: half of that is left of second order."""
REFLECTANCE_RADIANCE = 0.08
"""Radiance from below a clear sea against Lee et al. 2004, who fitted it for suns, not for a uniform sky: 6 % is found."""
REFLECTANCE_CASE1 = 0.2
"""Reflectance against Morel & Maritorena 2001, whose factor 0.33 varies between 0.29 and 0.36 with the sun and whose
absorption at 480 nm is a tenth higher than that of the tables."""
CLEAR_OCEAN = 0.2
"""Water-leaving radiance of the clear ocean: measurements scatter by 20 % (Gordon & Clark 1981)."""
FINEST_PATTERN = 0.02
"""Light that turns by less than 1e-4 rad still blurs a pattern of 3e4 cycles per radian by no more."""
SECOND_MOMENT = 0.02
"""The fourth moment of angles up to 22 degrees at 0.02 cycles per radian, and a transform read from a table."""
PHOTONS = 0.015
"""Mean of 6e4 cosines: three standard errors."""
SUM_OF_GAUSSIANS = 0.02
"""Nine Gaussians a factor of two apart against a transform with the kink of a forward peak."""
QUADRATURE = 1e-8
"""A closed form against adaptive quadrature, which is asked for 1e-9."""
SHAFT = 0.02
"""Light scattered once behind a body, or of a lamp's cone: what the project asks."""
SUMMED = 1e-12
"""Some hundred segments that add up to a closed form, and cancel."""
MEAN_OF_WAVES = 0.01
"""Mean deviation over the waves, in the beam's own light: what the project asks; 64 places of maps 12 cm a pixel."""
FROXELS = 0.03
"""RMSE of the grid over the deviation's rms: what the project asks of the default grid."""
NEXT_TO = 1e-5
"""Light of directions 1e-6 rad apart, of the largest."""
OVERSHOOT = 0.15
"""What cubic convolution shoots over an edge, of its step (Keys 1981): 7 % in each direction of the grid."""
OPEN_WATER_CODES = 1.5
"""A veil's far end against the plate it is read from: maps of 1.4 degrees, filled where bodies hide the water."""
FILLED = 0.02
"""A harmonic function over the sphere, of range 3, found again from two of its rings: finite differences of 1.4
degrees, and values that are known are smoothed over half a pixel."""
DEEP_REFLECTANCE = 0.003
"""Van de Hulst's (1980) closed form of the reflectance of a deep medium: within 0.0021 of that of the H functions."""
TABLE_OF_PETZOLD = 2e-4
"""Built-in function of Petzold's against its published table given as a user's: its slope below 0.1 degree is that of two
rows of six figures instead of a rounded one."""
HG_BY_ANGLES = 2e-3
"""Henyey-Greenstein by 400 angles evenly in the logarithm, straight lines between: the square of a step, 3 %, times the
curvature of the logarithm."""
DRIVEN_APART = 2e-9
"""Beams in layers against one layer: the rate of a beam's mode is moved by 1e-9 from those of the water."""
NET_FLUX = 3e-6
"""Divergence of the net irradiance by differences over 0.2 mm, against -a E_0: the differences of 12 digits."""
LAYERS_OF_PROFILE = 0.35
"""Error of twice as many layers of a linear profile over that of once as many: a quarter, and higher orders."""

WINDOW_BY_STREAMS = 2e-4
"""Light through Snell's window by 200 directions, against that of the few streams of a light field."""
BALANCE = 0.04
"""White balance of a plate that a water is fitted to: a prior that it is neutral draws ratios of 10 % in by a quarter."""
FEWER_BANDS = 0.01
"""Attenuation of daylight over the fewer wavelengths that waters are compared at, against those of a medium: 0.3 %."""
LAYERED, LAYERED_MEAN = 0.02, 4e-3
"""Tables of layered water against the exact light of layers, 95 % of rays and their mean, relative to the largest
channel: 2e-3 and 1.5e-3 are found, with the camera 0.3 m above an interface; between nodes beyond it lines bend."""
MARCHED = 2e-3
"""A ray marched through layers: the mean of 2000 samples of a path's extinction, whose step an interface falls into, and
60 moments of the light by 32 directions."""
EQUAL_LAYERS = 1e-6
"""Equal layers against one water: 1e-13 on paths of decimetres, and tables of single precision."""
