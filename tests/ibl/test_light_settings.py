# SPDX-License-Identifier: Apache-2.0
"""What a user says about the light is checked before anything is drawn."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mr360uw.errors import SceneError
from mr360uw.ibl.settings import LightSettings
from mr360uw.scene.model import scene_from_dict

NIGHT = {"sun": "date", "sun_time": "2026-06-21T00:00:00+00:00", "place_deg": (30.0, 0.0)}


def refused(**light: object) -> str:
    """Return the problem that a scene with this `[light]` has."""
    with pytest.raises(SceneError) as caught:
        scene_from_dict({"plate": {"path": "missing.png"}, "light": light}, Path())
    (problem,) = caught.value.problems
    return problem


def test_a_date_at_night_is_refused_with_the_way_out() -> None:
    problem = refused(**NIGHT)
    found = re.search(r"sun is ([\d.]+) degrees below the horizon", problem)
    assert found is not None
    assert float(found[1]) == pytest.approx(90.0 - 30.0 - 23.44, abs=0.5)  # the sun of midnight at midsummer
    assert "zone" in problem
    assert '"none"' in problem
    assert "ISO 8601" in refused(sun="date", sun_time="noon")
    assert "time zone" in refused(sun="date", sun_time="2026-06-21T12:00:00")
    # the time alone says nothing until the sun comes from it, and day is day
    assert LightSettings(**{**NIGHT, "sun": "detect"}).sun_time
    assert LightSettings(**{**NIGHT, "sun_time": "2026-06-21T12:00:00+00:00"}).sun == "date"
