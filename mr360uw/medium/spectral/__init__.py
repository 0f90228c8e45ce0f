# SPDX-License-Identifier: Apache-2.0
"""Spectra and colour: sensors, wavelength bands, gamut compression, reflectance from RGB."""
