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

# --- objects and compositing -----------------------------------------------------------------------------------

# --- video -----------------------------------------------------------------------------------------------------

# --- whole frames ----------------------------------------------------------------------------------------------
