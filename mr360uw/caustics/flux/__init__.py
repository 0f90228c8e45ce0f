# SPDX-License-Identifier: Apache-2.0
"""Irradiance below the surface: refracted rays, and their flux deposited by exact coverage."""
