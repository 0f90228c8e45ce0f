# SPDX-License-Identifier: Apache-2.0
"""Distances of what a plate shows, from the motion of its camera or from two eyes, and the water that they tell.

distances       of one frame from neighbours with known poses
depth_of_clip   of all frames of a tracked clip, as files
eye_distances   of both eyes of a stereo panorama, from their disparity
depth_of_eyes   of all frames of a stereo plate, as files
water_of_clip   attenuation and veil of the water, from places seen at several distances
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
