# SPDX-License-Identifier: Apache-2.0
"""What all rooms stand on: numbers, colours, directions, rays, files, caches, threads; no water, no OpenGL."""
