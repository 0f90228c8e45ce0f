# SPDX-License-Identifier: Apache-2.0
"""Image-based lighting from the plate: expansion to scene radiance, environment maps, the sun.

environment, environment_from_yuv   radiance, irradiance, glossy levels, sun and residual of one frame
expand                              inverse tone mapping of a whole plate
detect_sun                          the sun, clipped or not
irradiance, prefilter, split_sum    the integrals themselves
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
