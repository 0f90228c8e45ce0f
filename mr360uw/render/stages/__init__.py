# SPDX-License-Identifier: Apache-2.0
"""Stages of the plan and of the frame that have modules of their own."""
