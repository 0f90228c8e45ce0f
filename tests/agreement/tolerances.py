# SPDX-License-Identifier: Apache-2.0
"""Tolerances of shader functions against their Python partners, each with its reason."""

from __future__ import annotations

from tests.caustics.tolerances import COVERAGE_TWIN
from tests.tolerances import FLOAT32_LOOKUP, FLOAT32_TWIN, FRESNEL_TWIN

FILTER_WEIGHTS = 8e-3
"""A lookup that graphics hardware filters, of pixels up to 1.5 apart: its weights have 8 bits, so each of the two axes
and levels is off by up to 1/512 of that. Software drivers filter in single precision."""
GGX_LOBE = 3e-4
"""A GGX lobe in single precision: 1 - (n.h)^2 (1 - alpha^2) loses the digits ahead of alpha^2, which is 0.0025 at the
least here, and is squared."""
