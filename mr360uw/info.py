# SPDX-License-Identifier: Apache-2.0
"""What the toolkit runs on here."""

from __future__ import annotations

import importlib.metadata
import platform

from mr360uw.reading.disk_cache import cache_folder, cache_notes, kernel_folder
from mr360uw.reading.extras import EXTRAS, command

_PACKAGES = ("numpy", "scipy", "numba", "av", "opencv-contrib-python-headless", "OpenEXR", "moderngl", "trimesh",
             "embreex", "colour-science", "pydantic")  # fmt: skip
_NO_CARD = 'none, so output.encoder = "auto" takes those of the processor'
_ENCODERS = ("libx264", "libx265", "libsvtav1", "prores", "prores_ks", "ffv1")


def describe() -> str:
    """Return several lines: version, renderer and device, video library and encoders, packages, extras."""
    import av

    from mr360uw import __version__
    from mr360uw.errors import GlError
    from mr360uw.gl.context import gl_device
    from mr360uw.video.encoder import opening_encoders

    lines = [f"mr360uw {__version__}, Python {platform.python_version()}, {platform.platform()}"]
    try:
        device = gl_device()
        kind = "software" if device.software else "GPU"
        lines.append(f"renderer  gl: {device.renderer} ({kind}), OpenGL {device.version}, {device.vendor}")
    except GlError as error:
        lines.append(f"renderer  reference: {error}")
    ffmpeg = ".".join(str(part) for part in av.library_versions["libavcodec"])
    found = [name for name in _ENCODERS if name in av.codecs_available]
    lines.append(f"video     FFmpeg libavcodec {ffmpeg}; encoders {' '.join(found)}")
    lines.append(f"encoders  of graphics cards that open here: {' '.join(opening_encoders()) or _NO_CARD}")
    folder, kernels = cache_folder(), kernel_folder()
    lines.append(f"cache     {folder or 'none'}; compiled kernels in {kernels or 'none'}")
    lines += [f"note      {note}" for note in cache_notes()]
    lines += [
        f"package   {name} {version}" if version else f"package   {name} is not installed"
        for name, version in package_versions().items()
    ]
    lines += [f"extra     {extra}: {_extra(extra)}" for extra in EXTRAS]
    return "\n".join(lines)


def _extra(extra: str) -> str:
    """Return the versions of an extra's packages, or the command that installs it."""
    versions = [(name, _version(name)) for name in EXTRAS[extra]]
    if all(version for _, version in versions):
        return ", ".join(f"{name} {version}" for name, version in versions)
    return f"not installed - {command(extra)}"


def package_versions() -> dict[str, str]:
    """Return the versions of the packages that results depend on, "" for those that are not installed."""
    return {name: _version(name) for name in _PACKAGES}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""
