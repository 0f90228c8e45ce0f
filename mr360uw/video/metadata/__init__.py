# SPDX-License-Identifier: Apache-2.0
"""Container metadata: spherical video, colour tags, gravity tracks."""
