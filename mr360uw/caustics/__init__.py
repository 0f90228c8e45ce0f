# SPDX-License-Identifier: Apache-2.0
"""The sea surface and the caustics it casts."""
