# SPDX-License-Identifier: Apache-2.0
"""Distances of what a plate shows, from the motion of its camera.

distances       of one frame from neighbours with known poses
depth_of_clip   of all frames of a tracked clip, as files
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
