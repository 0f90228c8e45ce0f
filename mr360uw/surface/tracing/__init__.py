# SPDX-License-Identifier: Apache-2.0
"""Rays through the surface, compiled."""
