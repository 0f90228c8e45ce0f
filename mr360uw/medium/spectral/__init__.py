# SPDX-License-Identifier: Apache-2.0
"""Between spectra and colour: sensors, wavelength bands, gamut, reflectance from RGB."""
