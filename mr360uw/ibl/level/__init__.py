# SPDX-License-Identifier: Apache-2.0
"""The camera's level: tilt over time from keys or gravity, and the horizon estimated from a plate."""
