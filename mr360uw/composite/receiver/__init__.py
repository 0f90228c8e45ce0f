# SPDX-License-Identifier: Apache-2.0
"""The surface of the plate that catches shadows and caustics."""
