# SPDX-License-Identifier: Apache-2.0
"""A synthetic 360 dive with everything known: plate, sound, mesh and scene file."""

from __future__ import annotations

from mr360uw.sample.dive import SampleDive, check_recording, sample_dive
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.rendered_dive import Dive

__all__ = ["Dive", "DiveSettings", "SampleDive", "check_recording", "sample_dive"]
