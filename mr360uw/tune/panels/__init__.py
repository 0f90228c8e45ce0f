# SPDX-License-Identifier: Apache-2.0
"""The parts of the tuning page: header, controls, picture, time, placing, matching, rendering."""
