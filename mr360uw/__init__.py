# SPDX-License-Identifier: Apache-2.0
"""Put virtual objects into 360 degree underwater video, physically right."""
