# SPDX-License-Identifier: Apache-2.0
"""The sun: detected in a plate, split from the sky, computed from the date, tracked over a clip."""
