# SPDX-License-Identifier: Apache-2.0
"""Samples in time: the frames of a clip in which slow quantities are measured, interpolated between them."""

from __future__ import annotations

LIGHT_SAMPLES_HZ = 8.0
"""Samples in a second. Waves of 2 s, the shortest that move the sun much, are sampled 16 times; the gain of the veil is
smoothed over two to four seconds afterwards. Twice as large, measuring takes twice as long."""


def sample_step(frame_rate: float) -> int:
    """Return the number of frames from one sample to the next, 1 or more; frames whose index it divides are samples."""
    return max(round(frame_rate / LIGHT_SAMPLES_HZ), 1)
