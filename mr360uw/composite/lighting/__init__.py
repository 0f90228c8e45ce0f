# SPDX-License-Identifier: Apache-2.0
"""Shading of surfaces, visibility of lights, ambient occlusion."""
