# SPDX-License-Identifier: Apache-2.0
"""Video files and pictures as readers of frames."""
