# SPDX-License-Identifier: Apache-2.0
"""OpenGL without physics: the context, shader sources with #include, programs, textures."""
