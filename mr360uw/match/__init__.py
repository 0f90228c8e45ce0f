# SPDX-License-Identifier: Apache-2.0
"""Fits of a scene to what its plate shows: the sea to the caustics on the floor, the water to open water."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
