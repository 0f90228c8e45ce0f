# SPDX-License-Identifier: Apache-2.0
"""Solves the camera's path of a 360 clip from its pictures, by COLMAP's structure from motion."""
