# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mr360uw.depth.depth_files import depth_file, own_maps, write_depth
from mr360uw.depth.sphere_stereo import DepthMap


def write_own_maps(folder: Path, maps: Mapping[int, tuple[DepthMap, ...]]) -> None:
    """Write maps of frames, of one eye or of two, into a folder as `mr360uw depth` does."""
    with own_maps(folder, {"made_from": "a test"}, max(maps) + 1, overwrite=False) as record:
        for index, eyes in maps.items():
            write_depth(depth_file(folder, index), *eyes, file=record.file)
