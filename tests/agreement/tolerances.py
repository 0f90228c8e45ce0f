# SPDX-License-Identifier: Apache-2.0
"""Tolerances of lookups in shaders, each with its reason."""

from __future__ import annotations

from tests.tolerances import FLOAT32_LOOKUP, FLOAT32_TWIN

FILTER_WEIGHTS = 8e-3
"""A lookup that graphics hardware filters, of pixels up to 1.5 apart: its weights have 8 bits, so each of the two axes
and levels is off by up to 1/512 of that. Software drivers filter in single precision."""
