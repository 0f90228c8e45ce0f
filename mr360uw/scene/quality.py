# SPDX-License-Identifier: Apache-2.0
"""Qualities of a scene: values for the settings that trade time for accuracy, where the scene does not set them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from mr360uw.constants import MAXIMUM_SUN_SAMPLES

QUALITIES: Mapping[str, Mapping[str, Mapping[str, object]]] = {
    "draft": {
        "water": {"bands": 21},
        "caustics": {"size": 256, "planes": 2},
        "shafts": {"resolution": 512, "slices": 16},
        "draw": {"samples": 13, "sun_samples": 8},
    },
    "final": {},
    "reference": {
        "water": {"bands": 121},
        "caustics": {"size": 1024, "grid": 512, "planes": 8},
        "shafts": {"resolution": 2048, "slices": 128},
        "draw": {"shading": "sample", "sun_samples": MAXIMUM_SUN_SAMPLES},
    },
}
"""Values of each `draw.quality`, by table and key. "final" is the defaults of the tables. `mr360uw bench` measures what
each value costs and how far it is from the reference."""


def with_quality(data: Any) -> Any:
    """Return the tables of a scene with the values of its `draw.quality` where they have none of their own.

    data: as `Scene` is made of, tables or models by name; a value that is set is kept, the default of its key included.
    What is no such table, or of no known quality, is returned as it is, for the models to report.
    """
    draw = data.get("draw") if isinstance(data, dict) else None
    quality = draw.get("quality") if isinstance(draw, dict) else getattr(draw, "quality", None)
    tables = QUALITIES.get(quality, {}) if isinstance(quality, str) else {}
    filled = {name: _filled(data.get(name, {}), values) for name, values in tables.items()}
    return {**data, **filled} if filled else data


def _filled(table: Any, values: Mapping[str, object]) -> Any:
    if isinstance(table, BaseModel):
        return table.model_copy(update={key: v for key, v in values.items() if key not in table.model_fields_set})
    return {**values, **table} if isinstance(table, dict) else table
