# SPDX-License-Identifier: Apache-2.0
"""Frames in and out, sound, spherical metadata, EXR."""
