# SPDX-License-Identifier: Apache-2.0
"""Light in water: waters, sensors, wavelength bands, and the radiance along rays."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
