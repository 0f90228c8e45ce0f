# SPDX-License-Identifier: Apache-2.0
"""Caustic maps on OpenGL 3.3."""
