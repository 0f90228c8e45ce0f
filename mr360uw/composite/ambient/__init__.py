# SPDX-License-Identifier: Apache-2.0
"""Ambient light among bodies and the ground: what they keep from each other, and what they send back."""
