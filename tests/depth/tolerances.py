# SPDX-License-Identifier: Apache-2.0
"""Tolerances of distances found by motion, each with its reason."""

from __future__ import annotations

WITHIN = 0.06
"""Relative error of a distance that counts as right (docs/depth.md)."""
MEDIAN = 0.015
"""Median relative error at 512 columns where the confidence is a half or more; .003 at 1024 (docs/depth.md)."""
RIGHT = 0.93
"""Fraction of the confident pixels that are right, at any strength of caustics; .98 at 1024 (docs/depth.md)."""
FISH = 0.1
"""Fraction of the pixels of swimming fish that are confident at 512 columns; .03 at 1024 (docs/depth.md)."""
WRONG_BY_POSES = 0.005
"""Fraction of the sphere that is confident and wrong under poses 3 cm off; .04 were the poses taken for exact."""
RIG = 0.01
"""Fraction of the camera's own rig that is confident; a tenth of it would be, were it not looked for."""
COVERED, COVERED_THRICE = 0.93, 0.75
"""Fraction of the pixels in reach that are confident at 512 columns, under caustics as they are and three times as
strong; at 1024 more (docs/depth.md)."""
TINY = 0.06
"""Median relative error in pictures of 128 columns, whose pixels are 2.8 degrees wide."""
EDGE = 0.03
"""Mean error of alpha in the band around the edge of what is in front: 2 codes between a body and a rock that differ by 70."""
EYES = 0.03
"""Median relative error of distances by the disparity of two eyes: stills have .02."""
ATTENUATION, VEIL = 0.15, 0.08
"""Relative errors of attenuations and veils from places at several distances; most are within a third of it."""
ATTENUATION_OF_FEW = 0.25
"""The same of eight frames of 256 columns, in which caustics count for three times as much."""
SAME_PLACE = 0.03
"""Relative difference of the light of one place in two clear pictures of 256 columns, of which it covers few pixels."""
FLICKER = 2.0 / 70.0
"""Largest change of alpha from frame to frame in the band around the edge of what is in front, by grain and changing
light alone: 2 codes between a body and a rock that differ by 70. Maps of the size of the plate do not change at all."""
NORMAL_DEG = 5.0
"""Median angle between the normals of a floor or a rock and those of its distances that are off by .25 %, smoothed."""
RELIEF_RATIO = 0.06
"""Mean error of the light in a shadow on a rock, 26 pixels wide, by a map with an error of .25 % in each pixel: by normals
that are off by some degrees, as the fraction of light that is the sun's depends on them, and by the shadow's outline. On a
level floor in place of the rock it is .28."""
