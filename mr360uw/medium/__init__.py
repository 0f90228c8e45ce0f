# SPDX-License-Identifier: Apache-2.0
"""The water between things: waters, sensors, bands, scattering."""
