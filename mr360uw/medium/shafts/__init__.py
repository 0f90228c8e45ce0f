# SPDX-License-Identifier: Apache-2.0
"""Light shafts: sunlight and lamplight scattered once in the water, behind bodies and under waves."""
