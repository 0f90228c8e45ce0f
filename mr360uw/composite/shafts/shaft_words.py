# SPDX-License-Identifier: Apache-2.0
"""Whether a scene needs light in the water drawn, and why, in words with a number."""

from __future__ import annotations

from collections.abc import Callable

from mr360uw.medium.shafts.settings import ShaftSettings

_LEAST_SHARE = 0.01
"""Fraction of the veil that the beam's first scattering must add: what shafts change is less than that."""


def in_words(
    settings: ShaftSettings, share: Callable[[], float] | None, lit: bool, waves: bool, shading: bool, lamps: int
) -> tuple[bool, str]:
    """Return whether light in the water is drawn, and why.

    share: gives the fraction of the veil that is the beam scattered once (`medium.shafts.beam_share`); None: all of it.
    lit: whether there is a sun. waves, shading: whether waves or bodies change its beam. lamps: their number.
    """
    if not lamps and not (lit and (waves or shading)):
        return False, "no sun and no lamps" if not lit else "neither waves nor bodies change the beam"
    of_beam = 1.0 if share is None else share()
    if of_beam == 0.0 and not lamps:
        return False, "the water does not scatter"
    by = [word for word, there in (("waves", lit and waves), ("bodies", lit and shading), ("lamps", lamps)) if there]
    number = f"{100 * of_beam:.2g} % of the veil is light of the beam scattered once"
    if settings.mode == "auto" and of_beam < _LEAST_SHARE and not lamps:
        return False, f"{number}, below {100 * _LEAST_SHARE:g} %"
    least = f"; where codes change by {settings.least_codes:g}" if settings.least_codes else ""
    return True, f"by {', '.join(by)}; {number}{least}"
