# SPDX-License-Identifier: Apache-2.0
"""The sea surface: Gerstner and spectral waves, and the fine ripples on them."""
