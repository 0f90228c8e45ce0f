# SPDX-License-Identifier: Apache-2.0
"""Objects that belong there: meshes, shading, shadows, differential rendering."""
