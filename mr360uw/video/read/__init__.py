# SPDX-License-Identifier: Apache-2.0
"""Reads frames of video files and pictures."""
