# SPDX-License-Identifier: Apache-2.0
"""Writers of video files, sound and pictures."""
