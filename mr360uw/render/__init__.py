# SPDX-License-Identifier: Apache-2.0
"""Frames of a scene: loading, plan, camera, light, first pass over a clip, and the stages of one frame."""
