# SPDX-License-Identifier: Apache-2.0
"""The published methods of `mr360uw.caustics.published` on OpenGL."""
