# SPDX-License-Identifier: Apache-2.0
"""Writes video files, sound and pictures."""
