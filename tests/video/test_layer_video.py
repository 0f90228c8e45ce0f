# SPDX-License-Identifier: Apache-2.0
"""EXR layers become a video with alpha that editors lay over the plate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from mr360uw.base.color import XY_BY_NAME, encode, rec709_from_chromaticities
from mr360uw.video import read_spherical, write_exr
from tests.video.tolerances import VIDEO_PRORES_CODES

_SIZE = (32, 64)


def layers(folder: Path, numbers: tuple[int, ...] = (3, 4, 5), name: str = "rgba", primaries: str = "rec709") -> Path:
    """Half covered at the left, covered in the middle, light alone at the right; flat areas, which ProRes keeps."""
    rgba = np.zeros((*_SIZE, 4), np.float32)
    rgba[:, :16] = (0.1, 0.2, 0.05, 0.5)
    rgba[:, 16:32] = (0.3, 0.1, 0.6, 1.0)
    rgba[:, 48:, :3] = 0.02
    xy = XY_BY_NAME[primaries]
    rgba[..., :3] = rgba[..., :3] @ np.linalg.inv(rec709_from_chromaticities(np.reshape(xy, (4, 2)))).T
    for number in numbers:
        file, parts = folder / f"layer_{number:04d}.exr", {name: {"RGBA": rgba.astype(np.float16)}}
        write_exr(file, parts, attributes={"chromaticities": xy})
    return folder / "layer_%04d.exr"


def pictures(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "prores"
        assert stream.codec_context.pix_fmt.startswith("yuva444p1")
        assert stream.average_rate == 24
        return [
            f.reformat(format="rgba64le", src_colorspace=1).to_ndarray() / 65535.0 for f in container.decode(stream)
        ]


@pytest.mark.parametrize(
    ("alpha", "primaries"), [("straight", "rec709"), ("premultiplied", "rec709"), ("straight", "ap1")]
)
def test_layers_become_a_video_with_alpha(tmp_path: Path, run: Callable[..., Any], alpha: str, primaries: str) -> None:
    pattern, out = layers(tmp_path, (3, 4, 6), primaries=primaries), tmp_path / "layer.mov"
    code, said, _ = run("layer", pattern, out, "--alpha", alpha, "--frame-rate", "24")
    assert (code, "4 frames, 1 of them transparent" in said) == (0, True)
    made = pictures(out)
    half = encode(np.array([0.2, 0.4, 0.1]), "srgb") * (1.0 if alpha == "straight" else 0.5)
    whole = encode(np.array([0.3, 0.1, 0.6]), "srgb")
    alone = encode(np.full(3, 0.02), "srgb") * (alpha == "premultiplied")
    for picture in (made[0], made[3]):
        for column, rgb, cover in ((8, half, 0.5), (24, whole, 1.0), (40, np.zeros(3), 0.0), (56, alone, 0.0)):
            np.testing.assert_allclose(picture[16, column], [*rgb, cover], atol=VIDEO_PRORES_CODES)
    assert made[2].max() < VIDEO_PRORES_CODES
    assert read_spherical(out) is not None


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("rgba", ("none_%04d.exr", "out.mov"), "names no numbered EXR files"),
        ("rgba", ("layer_%04d.exr", "out.mp4"), "ProRes with alpha is a .mov (got .mp4) - name it out.mov"),
        ("rgba", ("layer_%04d.exr", "out.mov", "--frame-rate", "0"), "frame rate must be above 0"),
        ("rgba", ("layer_%04d.exr", "out.mov", "--frame-rate", "nan"), "a finite number (got nan)"),
        ("rgba", ("layer_%04d.exr", "out.mov", "--frame-rate", "inf"), "a finite number (got inf)"),
        ("rgba", ("layer_%04d.exr", "out.mov", "--frame-rate", "1e300"), "at most 1000 (got 1e+300)"),
        ("rgba", ("layer_%04d.exr", "out.mov", "--frame-rate", "1e-9"), "above 0"),
        ("rgba.left", ("layer_%04d.exr", "out.mov"), "has no part rgba (got rgba.left) - name an eye"),
        ("rgba", ("layer_%04d.exr", "missing/out.mov"), "the output folder is missing"),
    ],
)
def test_what_cannot_be_written_is_said(
    tmp_path: Path, run: Callable[..., Any], name: str, arguments: tuple[str, ...], message: str
) -> None:
    layers(tmp_path, name=name)
    before = sorted(p.name for p in tmp_path.iterdir())
    code, _, errors = run("layer", *(tmp_path / a for a in arguments[:2]), *arguments[2:])
    assert code == 2
    assert message in errors
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_an_output_is_not_replaced_unasked(tmp_path: Path, run: Callable[..., Any]) -> None:
    pattern = layers(tmp_path, name="rgba.right")
    for more, code in (((), 0), ((), 2), (("--overwrite",), 0)):
        assert run("layer", pattern, tmp_path / "out.mov", "--eye", "right", *more)[0] == code
