# SPDX-License-Identifier: Apache-2.0
"""From a loaded scene to frames: plan, camera, light, first pass, and the stages of one frame."""
