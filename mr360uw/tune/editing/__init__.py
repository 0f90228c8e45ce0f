# SPDX-License-Identifier: Apache-2.0
"""A scene that is edited: its document, its fields, its keys, presets; nothing of pages."""
