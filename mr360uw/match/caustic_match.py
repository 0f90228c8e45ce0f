# SPDX-License-Identifier: Apache-2.0
"""Fits a scene's sea to the caustics that its plate shows on the floor."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.settings import Sea
from mr360uw.match.floor_series import FloorSeries, NoMatchError, floor_series
from mr360uw.match.modelled_floor import ModelledFloor
from mr360uw.match.pattern_measures import PatternMeasures, bands, pattern_measures, relative_light
from mr360uw.match.sea_regression import SEAS, SeaFit, fit_sea, fitted_parameters, measurer
from mr360uw.progress import Progress
from mr360uw.scene.model import Scene
from mr360uw.shapes import checked

Array = NDArray[np.float64]

_LEAST_CONTRAST = 0.03
"""Standard deviation over mean of the floor's light below which nothing is fitted: codecs and drifting particles."""
_MOST_CONTRAST = 2.0
"""The same above which the floor is lost in the water's own light, whose noise is divided by what is left: focused
light has 0.1 to 1."""
_WAVES = (0.6, 1.7)
"""Frequencies over those of waves of the same length that count as caustics; caustics have 0.9 to 1.3."""
_LEAST_TOLD = 0.5
"""Least fraction of a parameter's variance that the pattern must tell for it to be changed."""
_LEAST_SENSE = 0.15
"""Least length of the mean direction of travel for the wind's direction to be changed; made seas have 0.4 to 0.7."""
_FINEST = 2.83
"""Shortest wavelength that is measured, over the median footprint of a pixel. At 2, what a codec takes of dark floors
moves the wind by 10 % more, and what is gained is a tenth of its uncertainty."""
_STATED_DOUBT, _SKY_DOUBT = 0.01, 0.15
"""Standard deviation of the logarithm of the beam's fraction on the floor, where `water.sun_share` states that of the
surface, and where it is taken for that of a clear sky: haze and thin cloud."""
_CLOSE = 0.15
"""Relative error that the confidence stands for."""
_SAME_CONTRAST = 0.2
"""Difference of the logarithms of two contrasts above which it is mentioned."""
_DIRECTION_SIGMA_DEG = 12.0
"""Standard deviation [deg] of the direction: that of the mean of some twenty waves, 55 degrees apart."""
_STRANGE = 1.5
"""Misfit above which the plate's pattern is unlike caustics of any made sea."""


@dataclass(frozen=True, slots=True, eq=False)
class CausticMatch:
    """The result of `match_caustics`.

    sentence: the result, or why there is none. changes: {key of the scene: value}; empty where nothing is fitted.
    confidence: 0 to 1, the likelihood that every changed parameter is right to 15 %, times how well the pattern is
    that of a sea. uncertainty: {key: one standard deviation, relative; of an angle in degrees}. plate, before, after:
    the floor in the plate, of the scene's sea and of the fitted one; None where there was none to measure. pixel_m: of
    their pictures.
    """

    sentence: str
    changes: dict[str, float] = field(default_factory=dict)
    confidence: float = 0.0
    uncertainty: dict[str, float] = field(default_factory=dict)
    plate: PatternMeasures | None = None
    before: PatternMeasures | None = None
    after: PatternMeasures | None = None
    pixel_m: float = 0.0

    @property
    def overrides(self) -> tuple[str, ...]:
        """The changes as `load_scene` and `--set` take them."""
        return tuple(f"{key}={value:g}" for key, value in self.changes.items())

    @property
    def distance_before(self) -> float:
        """Distance of the scene's caustics from the plate's, see `spectral_distance`; NaN without a fit."""
        return self._distance(self.before)

    @property
    def distance_after(self) -> float:
        """The same of the fitted sea."""
        return self._distance(self.after)

    def _distance(self, other: PatternMeasures | None) -> float:
        if self.plate is None or other is None:
            return math.nan
        return spectral_distance(self.plate, other)

    def pictures(self) -> dict[str, NDArray[np.uint8]]:
        """Return pictures (H, W, 3) uint8: `floor` and `spectra`, the plate's beside ours before and after."""
        from mr360uw.match.pattern_measures import floor_pictures, spectrum_pictures

        shown = [p for p in (self.plate, self.before, self.after) if p is not None]
        if not shown:
            return {}
        return {"floor": floor_pictures(shown), "spectra": spectrum_pictures(shown, self.pixel_m)}


@checked
def spectral_distance(one: PatternMeasures, other: PatternMeasures) -> float:
    """Return the mean absolute difference of the natural logarithms of two spectra over their bands.

    0.7 is a factor of two in power. Means of absolute values let one band stray.
    """
    return float(np.mean(np.abs(np.log(np.maximum(one.power, 1e-12) / np.maximum(other.power, 1e-12)))))


@checked
def match_caustics(
    scene: Scene, frames: tuple[int, int] | None = None, progress: Progress | None = None
) -> CausticMatch:
    """Return the sea whose caustics are like those of the plate on the floor in frames [a, b).

    frames: the first two seconds by default. The floor is seen in the square below and around the camera. The
    depths of camera and floor are the scene's: a floor that is really deeper makes a pattern of the same angle larger.
    The plate must show a level floor, whose receiver is a plane. Raises `VideoError` and `ParameterError`; where the
    floor shows no caustics the result says so.
    """
    try:
        series = floor_series(scene, frames, progress)
    except NoMatchError as refused:
        return CausticMatch(f"Nothing is matched. {refused}")
    edges = bands(series.grid.size_m, _FINEST * float(np.median(series.footprint_m)))
    measure = measurer(series.grid.pixel_m, series.step_s, edges)
    plate, features = measure(series.light)
    reason = _no_caustics(series, plate)
    if reason:
        return CausticMatch(f"Nothing is matched. {reason}", plate=plate, pixel_m=series.grid.pixel_m)
    share = scene.water.sun_share
    floor = ModelledFloor.of(series, share)
    doubt = _STATED_DOUBT if share > 0.0 else _SKY_DOUBT
    total = sum(SEAS)
    fit = fit_sea(scene.sea, floor, measure, plate, features, doubt, lambda done: progress and progress(done, total))
    changes, uncertainty = _changes(fit, plate, scene.sea)
    names = {key.removeprefix("sea."): value for key, value in changes.items()}
    seas = (scene.sea, scene.sea.model_copy(update=names))
    before, after = (
        pattern_measures(relative_light(floor.light(sea)), series.grid.pixel_m, series.step_s, edges) for sea in seas
    )
    confidence = _confidence(fit, uncertainty)
    match = CausticMatch("", changes, confidence, uncertainty, plate, before, after, series.grid.pixel_m)
    return replace(match, sentence=_sentence(match, fit, scene.sea))


def _no_caustics(series: FloorSeries, measures: PatternMeasures) -> str:
    """Return why a floor has no caustics that could be matched, "" where it has."""
    contrast = math.sqrt(float(measures.power.sum()))
    if float(np.median(series.light)) <= 0.0 or measures.contrast > _MOST_CONTRAST:
        return "The floor is no brighter than the water in front of it: too far, too murky, or not in view."
    if contrast < _LEAST_CONTRAST:
        return (
            f"The floor shows no caustics: its light moves by {100.0 * contrast:.1f} % "
            f"(at least {100.0 * _LEAST_CONTRAST:.0f} % are needed). The water is murky, or the floor in the shade."
        )
    slow, fast = _WAVES
    if not slow < measures.dispersion < fast:
        return (
            f"What moves on the floor is no caustics: its frequencies are {measures.dispersion:.1f} times those of "
            "waves of its size. The camera moves without a track, or the floor's height is wrong."
        )
    return ""


def _changes(fit: SeaFit, plate: PatternMeasures, sea: Sea) -> tuple[dict[str, float], dict[str, float]]:
    changes: dict[str, float] = {}
    uncertainty: dict[str, float] = {}
    for k, (name, *_) in enumerate(fitted_parameters(sea)):
        if fit.told[k] >= _LEAST_TOLD:
            changes[f"sea.{name}"] = float(f"{fit.value[k]:.3g}")
            uncertainty[f"sea.{name}"] = float(fit.sigma[k])
    if float(np.hypot(*plate.direction)) >= _LEAST_SENSE:
        changes["sea.wind_direction_deg"] = float(round(fit.direction_deg) % 360)
        uncertainty["sea.wind_direction_deg"] = _DIRECTION_SIGMA_DEG
    return changes, uncertainty


def _confidence(fit: SeaFit, uncertainty: dict[str, float]) -> float:
    """Return the likelihood that all errors are below 15 %, lowered where the pattern is unlike that of any sea."""
    relative = [sigma for key, sigma in uncertainty.items() if not key.endswith("_deg")]
    if not relative:
        return 0.0
    close = math.prod(math.erf(_CLOSE / max(sigma, 1e-6) / math.sqrt(2.0)) for sigma in relative)
    return close * math.exp(-0.5 * max(fit.misfit - _STRANGE, 0.0) ** 2)


def _sentence(match: CausticMatch, fit: SeaFit, sea: Sea) -> str:
    """Return the result in plain words."""
    parts, untold = [], []
    for name, _, _, words, unit in fitted_parameters(sea):
        key = f"sea.{name}"
        if key in match.changes:
            percent = round(100.0 * match.uncertainty[key])
            parts.append(f"{words} {match.changes[key]:g} {unit} (+-{percent} %)")
        else:
            untold.append(words)
    if "sea.wind_direction_deg" in match.changes:
        parts.append(f"towards {match.changes['sea.wind_direction_deg']:.0f} degrees")
    else:
        untold.append("direction")
    text = f"The floor's caustics are those of {', '.join(parts)}." if parts else "The pattern tells no parameter."
    if untold:
        text += f" The pattern does not tell: {', '.join(untold)}; left as in the scene."
    text += f" Their spectrum differs by {match.distance_after:.2f} then, by {match.distance_before:.2f} before."
    assert match.plate is not None
    assert match.after is not None
    ratio = match.plate.contrast / max(match.after.contrast, 1e-6)
    if abs(math.log(max(ratio, 1e-6))) > _SAME_CONTRAST:
        text += f" The plate's contrast is {ratio:.2f} of ours: see water.sun_share and the water."
    if fit.misfit > _STRANGE:
        text += " The pattern is unlike that of any sea tried: check the depths, the floor's height and its motion."
    return text
