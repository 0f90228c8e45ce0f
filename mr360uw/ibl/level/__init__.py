# SPDX-License-Identifier: Apache-2.0
"""The camera's tilt: from keys, from a GoPro gravity track, or estimated from Snell's window in a plate."""
