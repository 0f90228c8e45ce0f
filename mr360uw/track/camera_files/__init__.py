# SPDX-License-Identifier: Apache-2.0
"""Paths of cameras in the files of other programs."""
