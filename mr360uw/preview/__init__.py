# SPDX-License-Identifier: Apache-2.0
"""Previews of a scene: one frame, a view into it, a sheet of variants, a report on the plate."""
