# SPDX-License-Identifier: Apache-2.0
"""What bodies see of each other."""
