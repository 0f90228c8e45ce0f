# SPDX-License-Identifier: Apache-2.0
"""Rays against triangles, for the reference renderer."""
