# SPDX-License-Identifier: Apache-2.0
"""Tolerances of distances found by motion, each with its reason."""

from __future__ import annotations

WITHIN = 0.06
"""Relative error of a distance that counts as right: what the project asks."""
MEDIAN = 0.015
"""Median relative error at 512 columns where the confidence is a half or more: the project asks for .01 at 1024."""
RIGHT = 0.93
"""Fraction of the confident pixels that are right: what the project asks, at any strength of caustics."""
RIGHT_THRICE = 0.85
"""The same at 512 columns under caustics three times as strong, where windows hold a quarter of the pixels."""
FISH = 0.1
"""Fraction of the pixels of swimming fish that are confident at 512 columns: the project asks for .05 at 1024."""
COVERED, COVERED_THRICE = 0.7, 0.3
"""Fraction of the pixels in reach that are confident at 512 columns, under caustics as they are and three times as
strong; at 1024 more (docs/depth.md)."""
TINY = 0.06
"""Median relative error in pictures of 128 columns, whose pixels are 2.8 degrees wide."""
EDGE = 0.03
"""Mean error of alpha in the band around the edge of what is in front: what the project asks."""
