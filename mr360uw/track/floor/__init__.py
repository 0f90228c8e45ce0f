# SPDX-License-Identifier: Apache-2.0
"""The floor of a tracked clip: a mesh for the receiver, made of the points of its track."""
