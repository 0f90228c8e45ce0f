# SPDX-License-Identifier: Apache-2.0
"""The tuning page: a scene is changed by eye in a browser, frame by frame, and rendered by the library."""
