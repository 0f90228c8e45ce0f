# SPDX-License-Identifier: Apache-2.0
"""Bodies at the water's surface: mirrored in it, seen through it, cut by it, afloat on it."""
