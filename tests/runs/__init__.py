# SPDX-License-Identifier: Apache-2.0
"""Runs in parts: what is kept, what is done again, who may write."""
