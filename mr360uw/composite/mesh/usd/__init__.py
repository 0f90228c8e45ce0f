# SPDX-License-Identifier: Apache-2.0
"""Universal Scene Description: meshes and materials, read by the package usd-core."""
