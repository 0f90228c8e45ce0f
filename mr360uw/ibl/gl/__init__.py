# SPDX-License-Identifier: Apache-2.0
"""Environment maps reduced on OpenGL 3.3."""
