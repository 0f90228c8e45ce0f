# SPDX-License-Identifier: Apache-2.0
"""The receiver: the surface of the plate that shows shadows and caustics."""
