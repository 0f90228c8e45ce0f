# SPDX-License-Identifier: Apache-2.0
"""Marine snow: aggregates suspended in the water between camera and plate, as a part of a shot's layer."""
