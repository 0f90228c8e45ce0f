# SPDX-License-Identifier: Apache-2.0
"""Costs and errors of the settings that trade time for accuracy, measured stage by stage on this machine."""
