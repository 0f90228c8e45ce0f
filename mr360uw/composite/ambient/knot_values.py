# SPDX-License-Identifier: Apache-2.0
"""What shading reads of the ambient light at a place of a body."""

from __future__ import annotations

CHANNELS = 12
"""Values of a knot: ratio of irradiance (3), 0; ratio of glossy light that is kept (3), 0; radiance that is reflected
besides (3), 0."""
UNTOUCHED = (1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, *[0.0] * (CHANNELS - 7))
"""Values where nothing is in the way."""
