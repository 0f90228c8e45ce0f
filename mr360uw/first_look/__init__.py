# SPDX-License-Identifier: Apache-2.0
"""First look: what a plate and a mesh show by themselves, and the scene that `mr360uw new` proposes from it."""
