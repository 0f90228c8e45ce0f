# SPDX-License-Identifier: Apache-2.0
"""Reads and writes frames: video files, pictures, sound, spherical metadata and OpenEXR.

with open_video("dive.mp4") as video, create_video("out.mp4", like=video) as out:
    for frame in video.frames():
        out.write(frame)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
