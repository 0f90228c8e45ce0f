# SPDX-License-Identifier: Apache-2.0
"""Meshes, materials and textures, and the files they are read from."""
