# SPDX-License-Identifier: Apache-2.0
"""Between code values and linear light: planes, RGB, grain."""
