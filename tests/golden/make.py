# SPDX-License-Identifier: Apache-2.0
"""Draws the golden pictures anew with the reference renderer: python -m tests.golden.make."""

from __future__ import annotations

from mr360uw.composite import render_layer
from tests.golden.pictures import composite_codes, shots, write_golden

if __name__ == "__main__":
    for name, shot in shots().items():
        write_golden(name, composite_codes(render_layer, shot))
