# SPDX-License-Identifier: Apache-2.0
"""Pictures and films of a shallow sea by a camera in the air."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
