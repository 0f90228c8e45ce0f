# SPDX-License-Identifier: Apache-2.0
"""Ambient light that bodies block on the ground, and what they see of it."""
