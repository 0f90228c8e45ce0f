# SPDX-License-Identifier: Apache-2.0
"""The water as a plate shows it: its veil's colour by direction, its gain over a clip, the nearest water type."""
