# SPDX-License-Identifier: Apache-2.0
"""Reads the raw metadata track (GPMF) of a GoPro file."""

from __future__ import annotations

from pathlib import Path

from mr360uw.errors import VideoError
from mr360uw.reading.input_files import read_data


def gpmf_payloads(path: str | Path) -> bytes:
    """Return the GPMF payloads of a video's metadata track one after the other, or a file that holds just these.

    Raises `VideoError` where the video has no such track.
    """
    import av.error

    from mr360uw.video.read.probe import check_file, open_packets

    path = Path(path)
    if path.suffix.lower() in (".bin", ".gpmf"):
        return read_data(path, VideoError)
    check_file(path)
    try:
        with open_packets(path) as container:
            tracks = [s for s in container.streams if s.type == "data" and "GoPro MET" in str(s.metadata)]
            if tracks:
                return b"".join(bytes(packet) for packet in container.demux(tracks[0]) if packet.size)
    except (av.error.FFmpegError, OSError) as error:
        raise VideoError(f"{path} - cannot be read as a video (got {error}) - give the camera's own file") from error
    raise VideoError(f"{path} - has no GoPro metadata track (got none named 'GoPro MET') - give the camera's own file")
