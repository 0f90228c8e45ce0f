# SPDX-License-Identifier: Apache-2.0
"""Estimates how a plate was filmed and graded, and gives the bodies laid into it the same look."""
