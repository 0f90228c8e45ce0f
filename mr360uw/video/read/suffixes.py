# SPDX-License-Identifier: Apache-2.0
"""Ends of the names of pictures, in lower case; everything else is a video."""

from __future__ import annotations

INTEGER_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
FLOAT_SUFFIXES = (".exr", ".hdr")
PICTURE_SUFFIXES = INTEGER_SUFFIXES + FLOAT_SUFFIXES
