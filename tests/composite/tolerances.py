# SPDX-License-Identifier: Apache-2.0
"""Tolerances of objects and compositing, each with its reason."""

from __future__ import annotations

from tests.tolerances import (
    FLOAT32,
    FLOAT32_LOOKUP,
    FLOAT64,
    HALF_FLOAT,
    MAP_RATIO,
    RENDERERS_CODES,
    RENDERERS_FRACTION,
    RENDERERS_PSNR_DB,
)

HULL_SHALLOW = 1.1e-4
"""Part of the extent that points of very large meshes may stand out of their hull (1e-4), and of its rounding."""
SMOOTH_NORMALS = 0.002
"""Cosine between the normals of a sphere and those found from a mesh of 24 rows: half a step is 4 degrees at most."""
POLYGON_AREA = 0.01
"""A sphere of 32 rows of flat facets lies inside the round one."""
RECTANGLE_PIXELS = 4
"""A rectangle is one pixel wider than the triangle on every side, which itself may miss pixel centres."""
FURNACE = 0.005
"""A white body in white light vanishes to within half a per cent."""
FLUSH_CARD = 0.02
"""A card of the ground's colour, 0.1 mm thick, on the ground: it differs by its side faces and by its own shadow, 0.014.
With ratios from the centres of partly covered pixels it is 0.3."""
POLE_AREA = 0.005
"""Area of a body: facets instead of a round sphere, and finitely many samples at its edge."""
ROLL_CODES = 1.0
"""A turn by whole columns moves every sample to another one exactly, but for roundings at edges."""
PENUMBRA = 0.03
"""Sun disc by 96 directions against 1024: about n^-3/4 of the disc."""
BALL_SHARE = 0.012
"""Share of the ground's light that a ball of 48 rows blocks: a plan of 32 cells, 24 azimuths, and flat facets."""
BOX_SHARE, BOX_CONTACT = 0.02, 0.05
"""The same of boxes against 4096 rays (0.004), and within .02 of their outline, where it changes within the spread of the
azimuths."""
EXACT_BOX = 0.012
"""The same against the closed form: 24 azimuths, at places some millimetres within the edge of a low box."""
SHEETS = 0.012
"""The same of walls without thickness, which have one of a hundredth of their half length."""
RING = 0.02
"""The same of a ring, whose hole is known to a part of a cell of the plan: .017."""
BETWEEN_SAMPLES = 0.004
"""Root mean square error of the ground's ambient light between samples: their tolerance, half a code. It was 0.002."""
AT_OUTLINES = 0.02
"""Places within a sample's distance of a box's outline, and below a body, where what it sends down varies fast."""
MONOTONE = 0.001
"""Steps upwards of that share along a radius: a tenth of what the eye sees in an 8-bit video (quadrature over azimuth)."""
REDDENED = 0.03
"""Least that red gains over green beside a ball of reflectance .9 in the sun; without it nothing."""
CLOSED_BOX = 1e-5
"""Light inside a white box keeps to what it is: sums of 500 terms in single precision."""
MIRROR_IN_CRATE = 0.6
"""What a mirror in a black crate that is open above may still send, over what it sends in the open."""
BALLS = 0.025
"""512 directions of which a ball's edge cuts some, and samples a twelfth of a ball apart."""
TURNED = 0.01
"""A quarter turn of all: directions stay with the body, the environment's blocks of 2 x 2 pixels turn by whole ones."""
LIT_BY_A_PATCH = 0.06
"""Light of a disc of the ground: its edge is as wide as a node, a seventh of its radius, and the ball itself takes 2.8 %
of the light on it. What the camera sees straight below it is a sixth of it."""
REFLECTED_PATCH = 0.06
"""Root mean square error of a reflection of that disc, of contrast .9: the same edge, and lobes as wide as 9 degrees."""
SWIMMING_BY = 2e-4
"""Steps of a ball's mean light while another fades from view in thirty steps: whole, it takes .0015 of it."""
FAR_BODY = 0.004
"""Light that a ball ten radii away hides, taken from the middle of another instead of from its surface: .0023 of .0123
straight ahead, and a direction's width beside it."""
ONE_STEP = 0.016
"""Steps of a ball's light anywhere on it while another moves by a twentieth of a radius five radii away: two of 512
directions, each .0078 of the light, pass the other's edge at once."""
LOOKOUT_PLANE = 0.02
"""A unit ball's normals interpolated from coarse samples that are nowhere farther than .18: half of the square of that, .016, is
what a sphere leaves its tangent plane by."""
COSINE_SUM = 0.005
"""Sum over 512 directions of a cosine that is cut off at the horizon."""
POINT_PLACE = 0.01
"""Samples move inwards by a tenth of their distance, a twenty-sixth of the box, and stand off its faces."""
QUADRATURE = 0.002
"""A midpoint sum of some hundred to some thousand terms."""
TEXTURE_TWIN = 2e-3
"""Half-float texels between which single precision mixes; coordinates of 3e-7 times 40 texels."""
AOV_DIFFERENCE = 0.02
"""An output variable, gl against the reference: the shadow map's steps where the sun is half covered."""
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
"""Largest error of the ground's pixels, in codes: at narrow edges of shadows, 24 wide rays against 384 narrow ones, 5.8.
With block corners alone it is 30 to 100."""
BLOCK_ERROR = 0.04
"""Sum of the errors of the ground's pixels over that of its changes: 0.001 to 0.013 for bodies, 0.02 for balls a few
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
HARD_EDGE = 0.05
"""Lit fraction of a pixel at a straight edge, largest of 2 x 10^3: 0.039 by 24 wide rays, 0.022 by 384 narrow ones."""
LAMP_WALL = 5e-3
"""Light of a lamp against the closed form: a pixel is lit at one of its samples, and tables are linear between nodes."""
LAMP_GROUND = 1e-2
"""The same on the ground: single precision, and pixels whose middle stands for them."""
LAMP_HALF = 0.02
"""Visible fraction of a disc by 128 directions: half of one on the edge, and the next."""
LAMP_FLUX = 1e-3
"""Integral of a lamp's intensity by the trapezoid rule, whose steps a sharp edge of the cone falls between."""
PATTERN_UMBRA = 0.03
"""Ground in the umbra against its ambient light: what is left of the sun at the umbra's rim, times the filaments."""
LOBE_RMSE = 0.03
"""Kept fraction of a lobe of roughness .4: some twelve of 512 directions lie in its core."""
HIGHLIGHT = 0.08
"""Highlight of roughness .35 on a ball of 10 pixels, over its brightest pixel: four places in a pixel against 64 pixels
are off by .05 where a pixel shows several groups of samples; one place is off by .17."""
POISSON_DEVIATIONS = 4.0
"""Standard deviations within which a Poisson number lies but for one seed of 16 000; the seeds are fixed."""
BALL_PHASE = 1e-8
"""Integral of a phase function by 200 000 trapezoids: their width squared over 12."""
SNOW_FLOAT32 = 1e-5
"""Pictures of snow in single precision, to which a few dozen particles of a pixel are added one after another."""
PHASE_MAP = 2e-6
"""White particles in even light: weights in single precision that add up to 1."""
SPECKLED_SUN = 1e-4
"""Ambient light on a ladder of 97 depths: 0.02 m apart over the points, straight lines between exponentials."""
ROLLED = 1e-8
"""Coverage of 1e-4 of a steradian and less a pixel: single precision, and chords as differences of squares."""

SURFACE_EDGE = 2.5 / 17.0
"""Coverage of a pixel of an image in a level sea: two of its 17 rays may pass an edge that is a rounding away."""
SURFACE_MEAN = 2e-4
"""Mean of that over the frame."""
SURFACE_RADIANCE = 0.02
"""Relative: a pixel is lit at one of its rays, its expectation is at its centre, 0.4 degrees apart at the most."""
SURFACE_DEGREES = 0.1
"""Angle [deg] of an image of a ball against that of the ray to its middle; a pixel has 0.35."""
SURFACE_FURNACE = 0.03
"""Radiance of 1: the split sum's albedo and the environment's 8-bit-like maps."""
FLOATING = 0.02
"""Height of the plane through 13 x 13 points against that of 201 x 201, over the waves' height under the body."""
LEANING = 2e-4
"""Slope of a plane through a tenth of a metre of a swell of 0.3 m against that in its middle: k^3 a d^2/10 = 4e-5, and more
where the wave is steep."""

BLUR_FOUND = 0.1
"""Relative, of a blur found in a power spectrum: the share of a pixel's own blur is not known better."""
MASK_AT_EDGE = 0.002
"""Linear light: the mask takes its coverage from the blurred body, without what is fainter than 1e-4."""
GRADE_INVERSE = 1e-9
"""Codes through a grade and back, float64: the closed form of the cubic loses half of the digits at its ends."""
GRADE_FLOAT32 = 1e-3
"""Light through a grade and back, float32: a code is known to 1e-7, a log curve of 14 stops multiplies its error."""
GRADED_COMPOSITE = 3.0 / 1023.0
"""Codes of a composite on planes of 10 bits: both plates and both results are rounded, and a slope of 1.4 adds."""
GRADED_LIGHT = 0.02
"""Light of a graded plate of 10 bits against the ungraded one: half a code of 1023 each, over a slope of 0.6."""
PATCH_BLACK = 0.01
"""Black from patches: a code of 8 bits is 0.004, and saturation that is not known mixes channels that differ by 0.02."""
PATCH_CODES = 0.02
"""Codes of a plate of 8 bits without the grade that patches in the water tell: black's error, half a code over the slope
of the grade, and of red the water's tables, whose light is nearly nothing."""
PATCH_NUMBER = 0.02
"""Numbers of a curve from exact patches whose untold numbers are at rest: the solver's stop, and black's share."""
GRADED_RENDER = 0.002
"""Codes of a composite in a graded plate of floats against the grade of the composite: half an 8-bit code, of light that
is read through tables of float32, and of devices that cut it to halves."""
TRIM = 2e-3
"""Light of a body with a trim of two stops: layers of half floats, at light below 2."""
CROWD_WITHIN_ONE_CODE, CROWD_CODES = 0.999, 8.0
"""Pixels of a crowd that keep their code where every pair of bodies is found by rays, and the most that one changes."""
CROWD_SHADOWS, CROWD_SHADOWS_RMS = 0.03, 0.1
"""Light that bodies take in the water by maps of fewer pixels: of all, and of segments of rays, over its root."""
INTERPOLATED_MOTION = 0.02
"""Root mean square of light between two samples against that solved there, for a box on the ground that turns by 5
degrees: at a point here and there three or four of 512 directions, each .0078 of the light, pass an edge between."""
DISC_PEAK, DISC_LOBE = 0.03, 0.12
"""Highlights of a light's disc against quadrature, over their peak: at the mirror direction, where an ellipse of half
vectors is taken for a disc of its area, and rms over the lobe: that of a disc wider than the lobe has a flatter top."""

SAMPLES_AT_EDGES = 1e-3
"""Pixels of which a sample lies so near to an edge that single precision sees it on its other side."""

COLUMNS_MEAN, COLUMNS_SHARED = 2e-3, 0.01
"""Visible fractions through columns against rays, mean: of 24 wide rays at edges .015, which are a tenth of the places.
Bodies that share a slot have columns that also hold the gaps between their heights."""
COLUMNS_OFF, COLUMNS_PART = 0.15, 0.01
"""Most places are nearer than this; it is the penumbra of a body that is thinner than a column is wide."""
COLUMNS_EDGE = 0.02
"""Penumbra of a straight edge against the area of the segment: 32 wide rays."""

PATTERN_CLIPPED = 0.025
"""RMS of clipped light in half shade against that of a plate which holds it: its red
tells it but for their different shares of ambient light."""
BLUR_ENERGY = 0.01
"""Light of blurred bodies over all of it: a Gaussian is cut off after three deviations, and rows at a pole are few."""
BLUR_PHOTONS = 0.03
"""Shares of light within angles by Gaussians on cells of 0.75 degrees, and by photons in the small-angle limit."""
PIXELS_MOVED = 0.002
"""Pixels that a camera's turn moves a body by: positions are kept in single precision."""
MEAN_POINT = 0.05
"""Pixels that a body's points move by: that of a pixel is the mean of its samples, which need not lie in one triangle."""
