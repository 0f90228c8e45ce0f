# SPDX-License-Identifier: Apache-2.0
"""`python -m mr360uw` is the command line."""

from mr360uw.cli import main

main()
