# SPDX-License-Identifier: Apache-2.0
"""Error and cost of the light field over the number of streams: python benchmarks/slabs.py [table|reference]

table: errors against tests/data/slabs.csv, and processor time. reference: makes that file with PythonicDISORT 1.8
(Ho & Pincus 2024, MIT; to be installed beside this package, which does not need it).
"""

from __future__ import annotations

import csv
import importlib.util
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.medium.slabs import Slab, errors, moments, slabs  # noqa: E402

DATA = ROOT / "tests" / "data" / "slabs.csv"
CONSERVATIVE = 0.999999
UP = (0.1, 0.5, 0.75, 0.8, 1.0)
"""Heights of directions; the nearest node of the reference is taken, where it needs no interpolation."""
NEAREST_RAD = 0.03
"""Directions nearer to the sun are left out: the field turns no light by less than 0.01 rad."""
COLUMNS = ("phase", "omega", "thickness", "sun_up", "albedo", "kind", "depth", "up", "azimuth_deg", "value")
STREAMS = (4, 8, 16, 24, 32, 48, 64)
SLABS = {
    64: [Slab("isotropic", w, t, sun, 0.0) for w in (0.2, 0.99, CONSERVATIVE) for t in (0.03125, 0.25, 1.0, 32.0)
         for sun in (0.1, 0.6)]
        + [Slab("isotropic", w, t, 0.0, 0.0) for w, t in ((0.2, 0.03125), (0.99, 1.0), (0.99, 32.0))]
        + [Slab("rayleigh", w, t, 0.080442, 0.0) for w in (0.5, CONSERVATIVE) for t in (0.2, 5.0)],
    96: [Slab("hg 0.75", CONSERVATIVE, 1.0, 1.0, 0.0), Slab("hg 0.75", CONSERVATIVE, 8.0, 1.0, 0.0)]
        + [Slab("hg 0.75", 0.9, 1.0, *rest) for rest in ((1.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.0, 0.5))]
        + [Slab("haze-l", CONSERVATIVE, 1.0, 1.0, 0.0)]
        + [Slab("haze-l", 0.9, 1.0, *rest) for rest in ((1.0, 0.0), (0.5, 0.0), (0.5, 0.8))],
    200: [Slab("hg 0.924", *rest) for rest in (
        (0.8, 1.0, 0.8, 0.0), (0.8, 4.0, 0.8, 0.3), (0.6, 10.0, 0.8, 0.3), (0.8, 4.0, 0.0, 0.3))],
}  # fmt: skip
"""By the reference's number of streams in both hemispheres, which resolves the phase function: nothing is truncated."""


def reference_rows(slab: Slab, streams: int) -> Iterator[tuple[str, float, float, float, float]]:
    """Yield kind, depth, up, azimuth [deg] and value at the top, in the middle and at the bottom of a slab."""
    if importlib.util.find_spec("PythonicDISORT") is None:
        print("left out: PythonicDISORT is not installed (pip install PythonicDISORT==1.8)")
        sys.exit(0)
    from PythonicDISORT.pydisort import pydisort

    kind, *g = slab.phase.split()
    orders = {"isotropic": 1, "rayleigh": 3}.get(kind, streams) if slab.sun_up else 1
    chi = float(g[0]) ** np.arange(streams) if g else np.resize(moments(kind), streams)
    mu, up_flux, down_flux, _, light = pydisort(
        slab.thickness, slab.omega, streams, chi, slab.sun_up or 0.5, 1.0 / slab.sun_up if slab.sun_up else 0.0, 0.0,
        b_neg=0.0 if slab.sun_up else 1.0 / np.pi, NFourier=orders,
        BDRF_Fourier_modes=[slab.albedo] if slab.albedo else [],
    )  # fmt: skip
    slant = kind != "isotropic" and 0.0 < slab.sun_up < 1.0
    half = streams // 2
    for depth in (0.0, 0.5 * slab.thickness, slab.thickness):
        signs = [1] * (depth > 0.0) + [-1] * (depth < slab.thickness or slab.albedo > 0.0)
        for azimuth in (0.0, 90.0, 180.0) if slant else (0.0,):
            seen = np.squeeze(light(depth, np.radians(azimuth)))
            for sign in signs:
                for node in (int(np.argmin(np.abs(mu[:half] - up))) for up in UP):
                    along = sign * mu[node] * slab.sun_up
                    across = np.sqrt((1.0 - mu[node] ** 2) * (1.0 - slab.sun_up**2)) * np.cos(np.radians(azimuth))
                    if not slab.sun_up or along + across < np.cos(NEAREST_RAD):
                        value = float(seen[node + half * (sign > 0)])
                        yield "radiance", depth, sign * float(mu[node]), azimuth, value
        yield "irradiance", depth, 1.0, 0.0, float(np.sum([np.squeeze(part) for part in down_flux(depth)]))
        yield "irradiance", depth, -1.0, 0.0, float(np.squeeze(up_flux(depth)))


def make_reference() -> None:
    """Write the reference values."""
    with DATA.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(
            ["phase", "omega", "thickness", "sun_up", "albedo", "kind", "depth", "up", "azimuth_deg", "value"]
        )
        for streams, cases in SLABS.items():
            for slab in cases:
                for kind, depth, up, azimuth, value in reference_rows(slab, streams):
                    of_slab = slab.phase, slab.omega, slab.thickness, slab.sun_up, slab.albedo
                    table.writerow([*of_slab, kind, depth, f"{up:.9g}", azimuth, f"{value:.7g}"])


def cost_ms(slab: Slab, streams: int, *, whole: bool) -> float:
    """Return the processor time [ms] to solve a slab, with all orders of the azimuth or without: least of five."""
    times = []
    for _ in range(5):
        start = time.process_time()
        field = slab.field(streams)
        if whole:
            field.at_azimuth(0.0)
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def table() -> None:
    """Print the largest errors of every kind of slab, and what one solution costs."""
    known = slabs(DATA.name)
    print(
        "largest error of radiance over the slab's largest, of irradiance over the incident; CPU ms: mean, all azimuths"
    )
    for phase in dict.fromkeys(slab.phase for slab in known):
        mine = [slab for slab in known if slab.phase == phase]
        for streams in STREAMS:
            radiance, irradiance = np.max([errors(slab, known[slab], streams) for slab in mine], axis=0)
            ms = (cost_ms(max(mine, key=lambda s: (0 < s.sun_up < 1, s.thickness)), streams, whole=w) for w in (0, 1))
            print(f"{phase:10s} {streams:3d} {radiance:9.1e} {irradiance:9.1e}   " + " ".join(f"{x:7.2f}" for x in ms))


if __name__ == "__main__":
    {"table": table, "reference": make_reference}[sys.argv[1] if sys.argv[1:] else "table"]()
