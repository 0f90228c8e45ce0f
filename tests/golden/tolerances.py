# SPDX-License-Identifier: Apache-2.0
"""Tolerances of the golden pictures, each with its reason."""

from __future__ import annotations

from tests.tolerances import RENDERERS_CODES, RENDERERS_FRACTION, RENDERERS_PSNR_DB

GOLDEN_CODES = 0.01
"""8-bit codes that the reference may be off by: 1/514 for the rounding to 16 bits, single precision in the rays."""
GOLDEN_RMS_CODES = 0.05
"""Root mean square of the same over all pixels: a ray that passes an edge on the other side on another processor moves
one of 8192 pixels by a few codes."""
SEEN_CODES, SEEN_FRACTION = 8.0, 0.01
"""A golden picture that shows its scene differs from the bare plate by this much in this part of its pixels."""
