# SPDX-License-Identifier: Apache-2.0
"""Light in the water of a shot: before its objects, and over the plate behind them."""
