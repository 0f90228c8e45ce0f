# SPDX-License-Identifier: Apache-2.0
"""Put virtual objects into 360 degree underwater video, physically right.

    import mr360uw as uw

    scene = uw.load_scene("reef.toml")
    report = uw.composite_video(scene, "out.mp4")

The packages `ibl`, `caustics`, `medium`, `surface`, `composite` and `video` hold the stages; every name is loaded when
it is used.
Conventions (axes, units, colour): `mr360uw.types`.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
