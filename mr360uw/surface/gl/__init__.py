# SPDX-License-Identifier: Apache-2.0
"""Pictures through the sea surface on OpenGL 3.3."""
