# SPDX-License-Identifier: Apache-2.0
"""The tuning page: a scene is set by eye in a browser, frame by frame. The command line alone imports it."""
