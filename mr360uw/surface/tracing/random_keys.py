# SPDX-License-Identifier: Apache-2.0
"""Random numbers of rays by 32-bit keys: PCG as a hash (Jarzynski & Olano 2020)."""

from __future__ import annotations

import math

from mr360uw.jit import exact

_BITS = 0xFFFFFFFF


@exact
def pcg(key: int) -> int:
    """Return the hash of a key, both in [0, 2^32)."""
    s = (key * 747796405 + 2891336453) & _BITS
    w = (((s >> ((s >> 28) + 4)) ^ s) * 277803737) & _BITS
    return (w >> 22) ^ w


@exact
def next_key(key: int, salt: int) -> int:
    """Return another key, a fixed function of this one."""
    return pcg(key ^ pcg(salt))


@exact
def uniform(key: int) -> float:
    """Return a number in (0, 1) of a key, of 24 bits."""
    return ((key >> 8) + 0.5) / 16777216.0


@exact
def normal_cumulative(x: float) -> float:
    """Return the standard normal distribution function."""
    return 0.5 * math.erfc(-x * math.sqrt(0.5))


@exact
def normal_density(x: float) -> float:
    """Return the standard normal density."""
    return math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)


@exact
def normal_quantile(p: float) -> float:
    """Return the x below which a share p of the standard normal distribution lies, 1e-11 < p < 1 - 1e-11.

    Wichura 1988, algorithm AS 241 (PPND16), without its part for smaller shares.
    """
    q = p - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        upper = (((2509.0809287301226727 * r + 33430.575583588128105) * r + 67265.770927008700853) * r
                 + 45921.953931549871457) * r + 13731.693765509461125  # fmt: skip
        upper = ((upper * r + 1971.5909503065514427) * r + 133.14166789178437745) * r + 3.387132872796366608
        lower = (((5226.495278852854561 * r + 28729.085735721942674) * r + 39307.89580009271061) * r
                 + 21213.794301586595867) * r + 5394.1960214247511077  # fmt: skip
        return q * upper / (((lower * r + 687.1870074920579083) * r + 42.313330701600911252) * r + 1.0)
    r = math.sqrt(-math.log(min(p, 1.0 - p))) - 1.6
    upper = (((7.7454501427834140764e-4 * r + 0.0227238449892691845833) * r + 0.24178072517745061177) * r
             + 1.27045825245236838258) * r + 3.64784832476320460504  # fmt: skip
    upper = ((upper * r + 5.7694972214606914055) * r + 4.6303378461565452959) * r + 1.42343711074968357734
    lower = (((1.05075007164441684324e-9 * r + 5.475938084995344946e-4) * r + 0.0151986665636164571966) * r
             + 0.14810397642748007459) * r + 0.68976733498510000455  # fmt: skip
    value = upper / (((lower * r + 1.6763848301838038494) * r + 2.05319162663775882187) * r + 1.0)
    return value if q > 0.0 else -value
