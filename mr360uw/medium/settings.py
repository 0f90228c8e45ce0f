# SPDX-License-Identifier: Apache-2.0
"""The `[water]` and `[shafts]` tables of a scene."""

from __future__ import annotations

from math import radians, sin
from pathlib import Path
from typing import Annotated, Literal, Self, cast

from pydantic import Field, field_validator, model_validator

from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.parameters import Parameters, advanced, parameter
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import LEAST_M, MOST_M, water_of_visibility, water_seen_as_far
from mr360uw.medium.medium import DEFAULT_BANDS, SOLVED, Medium, Mode
from mr360uw.medium.models import layered_water
from mr360uw.medium.phase import Phase, PhaseTable
from mr360uw.medium.spectra import DEFAULT_ILLUMINANT, DEFAULT_SENSOR, named_sensor
from mr360uw.medium.veil_gain import fit_gain
from mr360uw.medium.water import JerlovType, Water
from mr360uw.types import Floats

Place = Literal["tropical", "temperate", "harbour"]
PLACES: dict[str, JerlovType] = {"tropical": "IB", "temperate": "1C", "harbour": "7C"}
"""Words for waters, and the types they stand for: black targets are lost at 71, 27 and 5.4 m there."""
WaterType = JerlovType | Place | Literal["pure", "chlorophyll", "csv", "none"]
PhaseName = Literal["auto", "petzold", "isotropic", "water"]
MeanCosine = Annotated[float, Field(ge=-0.95, le=0.99)]
Index = Annotated[float, Field(ge=1.01, le=1.35)]
Slope = Annotated[float, Field(ge=3.05, le=4.95)]
Gain = Annotated[float, Field(ge=0.0, le=1e6)]


class WaterKindSettings(Parameters):
    """A water, and the sensor that sees it."""

    type: WaterType = parameter(
        "IB", "Jerlov type, tropical (IB), temperate (1C), harbour (7C), pure, chlorophyll, csv; none: no water"
    )
    visibility_m: float | None = parameter(
        None, "horizontal distance at which a black target is lost in the picture; alone: and the type", unit="m",
        low=LEAST_M, high=MOST_M,
    )  # fmt: skip
    chlorophyll_mg_m3: float = parameter(0.2, "for type chlorophyll: concentration", unit="mg/m^3", low=0.01, high=20.0)
    csv: Path | None = parameter(
        None, "for type csv: table with wavelength_nm, absorption, scattering and, if known, kd"
    )
    phase: PhaseName | MeanCosine | tuple[Index, Slope] | Annotated[Path, Field(strict=True)] = advanced(
        "auto", "phase function of the particles: by name, auto = the one that goes with the water; Henyey-Greenstein "
        "of a mean cosine; Fournier-Forand of [refractive index, slope of sizes], as in [1.1, 3.58]; or a CSV file "
        "with angle_deg, phase_function",
        fixed="water has one phase function",
    )  # fmt: skip
    sensor: str | Path = parameter(
        DEFAULT_SENSOR, "a built-in camera, CIE 1931, or a CSV file with wavelength_nm, R, G, B"
    )
    illuminant: str = parameter(
        DEFAULT_ILLUMINANT, "light that white is balanced for: equal-energy, D65, sun-sky, D50, A, ...",
        internal="water.sensor",
    )  # fmt: skip
    refractive_index: float = advanced(
        REFRACTIVE_INDEX_SEA, "refractive index relative to air, at 550 nm", unit="1", above=1.0, high=2.0
    )

    @field_validator("sensor", "phase", mode="before")
    @classmethod
    def _file(cls, value: object) -> object:
        return Path(value) if isinstance(value, str) and value.lower().endswith(".csv") else value

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.type == "csv" and self.csv is None:
            raise ValueError("csv - type csv needs a file (got none) - name it")
        return self

    @property
    def of_visibility_alone(self) -> bool:
        """True if the water follows from the visibility alone."""
        return self.visibility_m is not None and "type" not in self.model_fields_set

    @property
    def label(self) -> str:
        """The water in a few words, as the plan shows it."""
        sight = "" if self.visibility_m is None else f" of {self.visibility_m:g} m visibility"
        if self.of_visibility_alone:
            return f"water{sight}"
        known = PLACES.get(self.type)
        return (f"water {self.type}" if known is None else f"{self.type} water, type {known}") + sight

    def water(self) -> Water | None:
        """Return the water, or None for a plate without; raise `ParameterError` where tables cannot be used."""
        if self.type == "none":
            return None
        if self.of_visibility_alone and self.visibility_m is not None:
            water = water_of_visibility(self.visibility_m)
        else:
            water = self._named()
            water = water if self.visibility_m is None else water_seen_as_far(water, self.visibility_m)
        return water if self.phase == "auto" else water.with_phase(self._phase())

    def _named(self) -> Water:
        """Return the water of the type, there is one, with its own visibility."""
        if self.type == "pure":
            return Water.pure()
        if self.type == "chlorophyll":
            return Water.chlorophyll(self.chlorophyll_mg_m3)
        if self.type == "csv":
            if self.csv is None:
                raise ParameterError("csv - type csv needs a file (got none) - name it")
            return Water.from_csv(self.csv)
        kind = PLACES.get(self.type) or cast("JerlovType", self.type)
        return Water.jerlov(kind)

    def _phase(self) -> Phase:
        if isinstance(self.phase, float):
            return "hg", self.phase
        if isinstance(self.phase, tuple):
            return "fournier-forand", *self.phase
        if isinstance(self.phase, Path):
            return PhaseTable.from_csv(self.phase)
        assert self.phase != "auto"
        return self.phase


class WaterSettings(WaterKindSettings):
    """The water between camera and objects, its model, and the gain that matches the plate's exposure."""

    layers: Path | None = advanced(
        None, "water that changes with depth: a table with depth_m, wavelength_nm, absorption, scattering, in place of "
        "the type's; the phase function stays the type's"
    )  # fmt: skip
    shade: float = parameter(
        0.0, "share of its haze (veil) that the water near the camera lacks, as in caves and where an edit crushed the "
        "blacks; what is far away stays", unit="1", low=0.0, high=1.0,
    )  # fmt: skip
    mode: Mode = advanced(
        "plate",
        "how the haze (veil) is computed; plate = far away what the plate shows, on the way as the solved light "
        "field; table = that alone, kd = as published",
    )
    blur: bool = advanced(True, "whether the water blurs objects by the light that it turns by small angles")
    bands: int = parameter(
        DEFAULT_BANDS, "number of wavelengths; a pixel costs the same for any", low=1, high=1000,
        internal="draw.quality",
    )  # fmt: skip
    rough: bool = parameter(
        False, "whether the light about the sun is computed roughly", internal="drafts while a value is being moved"
    )
    sun_share: float = advanced(
        0.0,
        "fraction of the light below the surface that is the sun's beam; 0 = uniform sky",
        unit="1",
        low=0.0,
        high=1.0,
    )
    sun_elevation_deg: float = advanced(
        60.0, "elevation of that beam in the water", unit="deg", low=5.0, high=90.0
    )  # fmt: skip
    gain: Literal["auto"] | tuple[Gain, Gain, Gain] = advanced(
        "auto",
        "factor on the haze (veil) per channel, the same in all directions; auto = it has the plate's own colour, "
        "steady over a clip",
    )

    @model_validator(mode="after")
    def _check_layers(self) -> Self:
        if self.layers is not None and self.visibility_m is not None:
            raise ValueError(f"layers - have a visibility of their own (got {self.visibility_m:g} m) - leave one out")
        if self.layers is not None and self.mode not in SOLVED:
            raise ValueError(
                f"layers - need a solved light field (got mode {self.mode!r}) - take mode 'plate' or 'table'"
            )
        return self

    def water(self, camera_depth_m: float = 0.0) -> Water | None:
        """Return the water, or None for a plate without; of layers, all that does not ask for a depth is that of the
        camera's. Raises `ParameterError` where tables cannot be used.
        """
        water = super().water()
        return water if water is None or self.layers is None else layered_water(self.layers, water, camera_depth_m)

    @property
    def label(self) -> str:
        """The water in a few words, as the plan shows it."""
        return super().label if self.layers is None else f"water in layers of {self.layers.name}"

    @property
    def fits_gain(self) -> bool:
        """True if the gain of the veil is fitted to the plate."""
        return self.type != "none" and self.gain == "auto"

    @property
    def fits_ratio(self) -> bool:
        """True if the veil of long ways is taken from the plate in every direction."""
        return self.fits_gain and self.mode == "plate"

    def medium(
        self, camera_depth_m: float, radiance_map: Floats | None = None, floor_m: float | None = None
    ) -> Medium | None:
        """Return the medium of a camera at a depth, or None for a plate without water.

        floor_m: depth of a level floor, if there is one. radiance_map: (32, 64, 3) of the plate, from which gain "auto"
        reads the water's colour. Without it the gain is 1. Raises `ParameterError`.
        """
        # Make the medium as the table says, then set its gain: as given, or fitted to a plate
        water = self.water(camera_depth_m)
        if water is None:
            return None
        medium = Medium(
            water,
            named_sensor(str(self.sensor)),
            self.mode,
            camera_depth_m,
            band_count=self.bands,
            illuminant=self.illuminant,
            sky=("sun", sin(radians(self.sun_elevation_deg)), self.sun_share) if self.sun_share > 0.0 else "uniform",
            refractive_index=self.refractive_index,
            floor_m=floor_m,
        ).in_shade(self.shade)
        if self.rough:
            medium = medium.for_drafts()
        if self.gain != "auto":
            return medium.scaled(self.gain)
        if radiance_map is None:
            return medium
        return medium.scaled(fit_gain(medium, radiance_map)[0])


LEAST_NODES = 16
"""Least nodes around the sun."""
_LEAST_CODES = 2.0
"""Change of 8-bit code values below which light in the water is left out. Twice as much: shafts that can be seen go."""
_LONGEST_M = 500.0
"""Farthest [m] that shafts are followed: even the clearest water has dimmed them to nothing before."""


class ShaftSettings(Parameters):
    """Light in the water: shafts under waves, shadows of bodies in the water, beams of lamps."""

    mode: Literal["auto", "on", "off"] = parameter(
        "auto", "auto: where enough of the sun's beam is left, or lamps shine; on: however little is left; off: none"
    )
    strength: float = parameter(1.0, "factor on them; 1 is physical, 0 is off", unit="1", low=0.0, high=100.0)
    on_plate: bool = parameter(
        False, "shafts of the waves in all of the plate, which may show its own; those before objects are always drawn"
    )
    range_m: float = parameter(
        100.0, "distance from the camera up to which they are seen", unit="m", low=0.0, high=_LONGEST_M,
        internal="the water, which dims them",
    )  # fmt: skip
    resolution: int = parameter(
        1024,
        "nodes around the sun, 3/8 as many from it to its antipode; fewer in small frames",
        low=LEAST_NODES,
        high=2048,
        internal="draw.quality",
    )
    slices: int = parameter(32, "slices of the grid over distance", low=4, high=512, internal="draw.quality")

    @property
    def least_codes(self) -> float:
        """Change of an 8-bit code value from which on they are drawn."""
        return _LEAST_CODES if self.mode == "auto" else 0.0

    @property
    def why_off(self) -> str:
        """The reason why there is nothing to draw; "" where there may be."""
        if self.mode == "off":
            return "switched off"
        return "shafts.strength is 0" if self.strength == 0.0 else "shafts.range_m is 0" if self.range_m == 0.0 else ""
