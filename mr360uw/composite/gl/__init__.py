# SPDX-License-Identifier: Apache-2.0
"""The layer of a frame on OpenGL 3.3."""
