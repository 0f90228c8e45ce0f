# SPDX-License-Identifier: Apache-2.0
"""Several processes that render parts of one clip, on one machine or on many."""
