# SPDX-License-Identifier: Apache-2.0
"""Writes linear light as code values: Y'CbCr planes, RGB pictures, and the plate's grain."""
