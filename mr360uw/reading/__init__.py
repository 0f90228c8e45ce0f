# SPDX-License-Identifier: Apache-2.0
"""Reads input files: which files are read, how large they may be, and how large the pictures in them are."""
