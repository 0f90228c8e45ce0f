# SPDX-License-Identifier: Apache-2.0
"""What to look at while a scene is set: one frame, a view into it, a sheet of variants, a report on the plate."""
