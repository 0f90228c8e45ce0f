# SPDX-License-Identifier: Apache-2.0
"""Runs over a clip in parts: what is finished is kept beside the output, and a run that was killed goes on there."""
