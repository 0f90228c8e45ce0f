# SPDX-License-Identifier: Apache-2.0
"""Bodies in graded plates, against the grade of the composite made before it.

    python benchmarks/graded.py [--width W] [--preset NAME] [--pictures FOLDER] [--only NAME ...]
        [--ways WAY ...]

A synthetic dive is graded in eleven known ways and recorded again. A body laid into the graded clip is compared with
the grade of the composite that was made on the clip as it was. Code values of 8 bits; without `[match]`, with its
defaults (softness is measured), and with the grade given:

colour: largest difference of the body's mean R', G', B'. contrast: standard deviation of the body's luma over the
truth's. sharpness: root mean square gradient of luma over the body and its edge, over the truth's.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import mr360uw as uw  # noqa: E402
from mr360uw.base.cache import Cache  # noqa: E402
from mr360uw.base.color import encode, ycbcr_from_rgb  # noqa: E402
from mr360uw.composite.grading.settings import MatchSettings  # noqa: E402
from mr360uw.render.first_pass import clip_analysis  # noqa: E402
from mr360uw.render.frame import Backend, Frame, composite_frame, make_backend  # noqa: E402  # noqa: E402
from mr360uw.render.loaded import load  # noqa: E402
from mr360uw.sample.dive_settings import PRESETS, DiveSettings  # noqa: E402
from mr360uw.scene.model import Scene, load_scene  # noqa: E402
from mr360uw.types import Floats  # noqa: E402
from mr360uw.video import VideoFrame  # noqa: E402

FRAMES, JUDGED = 3, 1
COLOUR_CODES, CONTRAST, SHARPNESS = 4.0, 0.1, 0.1
LUMA = ycbcr_from_rgb("bt709")[0]
Grade = Callable[[Floats], Floats]
"""R'G'B' (H, W, 3) of 0 to 1 -> R'G'B'."""


def blur(deviation_px: float) -> Grade:
    """Return a Gaussian blur over the seam of a panorama."""

    def grade(code: Floats) -> Floats:
        wide = np.concatenate([code[:, -16:], code, code[:, :16]], axis=1)
        found: Floats = cv2.GaussianBlur(wide, (0, 0), deviation_px)[:, 16:-16]
        return found

    return grade


def sharpen(amount: float, deviation_px: float = 1.0) -> Grade:
    """Return an unsharp mask."""
    return lambda code: code + amount * (code - blur(deviation_px)(code))


def saturate(factor: float) -> Grade:
    """Return a factor on the distance from luma."""
    return lambda code: (code @ LUMA)[..., None] * (1.0 - factor) + factor * code


def lift(black: float, white: float = 1.0) -> Grade:
    """Return a straight line from black to white."""
    return lambda code: black + (white - black) * code


def s_curve(strength: float) -> Grade:
    """Return a curve of more contrast about the middle, which keeps black and white."""
    return lambda code: code + strength * code * (1.0 - code) * (2.0 * code - 1.0) * 2.0


def power(exponent: float) -> Grade:
    """Return a power of the code values."""
    return lambda code: np.clip(code, 0.0, 1.0) ** exponent


def same(code: Floats) -> Floats:
    """Return the code values themselves."""
    return code


GRADES: dict[str, tuple[Grade, int, dict[str, float]]] = {
    "none": (same, 14, {}),
    "blur 0.6": (blur(0.6), 14, {"softness": 0.6}),
    "blur 1.0": (blur(1.0), 14, {"softness": 1.0}),
    "blur 1.5": (blur(1.5), 14, {"softness": 1.5}),
    "sharpened 0.8": (sharpen(0.8), 14, {"sharpening": 0.8}),
    "lifted 0.06": (lift(0.06), 14, {"black": 0.06}),
    "lifted 0.06, white 0.9": (lift(0.06, 0.9), 14, {"black": 0.06, "white": 0.9}),
    "white 0.9": (lift(0.0, 0.9), 14, {"white": 0.9}),
    "s curve": (s_curve(0.4), 14, {"contrast": 1.4}),
    "power 0.8": (power(0.8), 14, {"gamma": 0.8}),
    "saturation 1.4": (saturate(1.4), 14, {"saturation": 1.4}),
    "crf 28": (same, 28, {}),
}
"""Grade, constant rate factor of x264, and the grade as a scene's `[match]` gives it."""
NEUTRAL = {"black": 0.0, "white": 1.0, "gamma": 1.0, "contrast": 1.0, "saturation": 1.0, "softness": 0.0}


@dataclass(frozen=True)
class Measured:
    """Mean R'G'B' (3,), standard deviation of luma and mean gradient of a body, in codes."""

    colour: Floats
    contrast: float
    sharpness: float


def measure(code: Floats, alpha: Floats) -> Measured:
    """Return the numbers of a body in a picture. alpha: (H, W), as drawn."""
    inside = cv2.erode(alpha, np.ones((5, 5))) > 0.99
    about = cv2.dilate(alpha, np.ones((5, 5))) > 0.0
    luma = 255.0 * code @ LUMA
    down, along = np.gradient(luma)
    edge = float(np.sqrt(np.mean((down**2 + along**2)[about])))
    return Measured(255.0 * code[inside].mean(axis=0), float(luma[inside].std()), edge)


def record(path: Path, pictures: Iterable[Floats], rate_factor: int) -> None:
    """Write R'G'B' pictures as H.264 of a constant rate factor."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(24))
        stream.options = {"crf": str(rate_factor), "preset": "veryfast"}
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.colorspace = context.color_primaries = context.color_trc = 1  # BT.709
        context.color_range = 1
        for number, code in enumerate(pictures):
            if number == 0:
                stream.height, stream.width = code.shape[:2]
            rgb = np.clip(np.rint(255.0 * code), 0, 255).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(rgb, format="rgb24")
            container.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))
        container.mux(stream.encode())


def codes_of(frame: VideoFrame) -> Floats:
    """Return the R'G'B' (H, W, 3) of a frame."""
    return encode(np.clip(frame.image_linear, 0.0, 1.0), "srgb")


def composite(scene: Scene, plate: Path, backend: Backend, match: MatchSettings) -> list[Frame]:
    """Return the frames of a clip with the scene's body in them."""
    scene = scene.model_copy(
        update={
            "plate": scene.plate.model_copy(update={"path": plate}),
            "match": match,
        }
    )
    video = uw.open_video(plate)
    loaded = load(scene, video.width, video.height)
    analysis = clip_analysis(loaded, video)
    for line in analysis.grade.found if analysis.grade is not None else ():
        print(f"      {line}")
    cache = Cache()
    return [composite_frame(loaded, analysis, backend, frame, 0.0, cache=cache) for frame in video.frames()]


def main() -> int:
    """Run the benchmark that the command line asks for; return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--preset", default="reef", choices=sorted(PRESETS))
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--ways", nargs="*", default=["as is", "default", "given"])
    parser.add_argument("--only", nargs="*", default=list(GRADES))
    options = parser.parse_args()
    missed = 0
    with tempfile.TemporaryDirectory() as name:
        folder, backend = Path(name), make_backend("auto")[0]
        dive = uw.sample_dive(
            folder / "dive", DiveSettings(**PRESETS[options.preset]), width=options.width, frames=FRAMES, samples=2
        )
        scene = load_scene(dive.scene, ["object.0.position_m=[0.3, -0.5, -2.2]"])
        off = MatchSettings(softness=0.0)
        clean = composite(scene, dive.plate, backend, off)
        alpha = clean[JUDGED].layer.alpha
        for label in options.only:
            grade, rate_factor, given = GRADES[label]
            record(folder / "plate.mp4", (grade(codes_of(f.plate)) for f in clean), rate_factor)
            record(folder / "truth.mp4", (grade(codes_of(f.picture)) for f in clean), rate_factor)
            truth = [codes_of(f) for f in uw.open_video(folder / "truth.mp4").frames()][JUDGED]
            goal = measure(truth, alpha)
            print(label)
            ways = {"as is": off, "default": MatchSettings(), "given": MatchSettings(**(NEUTRAL | given))}
            for way in options.ways:
                made = codes_of(composite(scene, folder / "plate.mp4", backend, ways[way])[JUDGED].picture)
                found = measure(made, alpha)
                colour = float(np.abs(found.colour - goal.colour).max())
                contrast, sharpness = found.contrast / goal.contrast, found.sharpness / goal.sharpness
                meets = colour <= COLOUR_CODES, abs(contrast - 1) <= CONTRAST, abs(sharpness - 1) <= SHARPNESS
                missed += way == "given" and not all(meets)
                print(
                    f"   {way:7s}  colour {colour:5.2f}  contrast {contrast:5.3f}  "
                    f"sharpness {sharpness:5.3f}  {'' if all(meets) else 'missed'}"
                )
                if options.pictures is not None:
                    options.pictures.mkdir(parents=True, exist_ok=True)
                    stem = label.replace(" ", "_").replace(",", "")
                    close(options.pictures / f"{stem}_{way.replace(' ', '_')}.png", made, truth, alpha)
    return int(missed > 0)


def close(path: Path, made: Floats, truth: Floats, alpha: Floats) -> None:
    """Write the body close up, composite over truth, six times as large."""
    rows, columns = (np.flatnonzero(np.any(alpha > 0.0, axis=axis)) for axis in (1, 0))
    window = slice(max(rows[0] - 8, 0), rows[-1] + 9), slice(max(columns[0] - 8, 0), columns[-1] + 9)
    both = np.concatenate([made[window], truth[window]])
    codes = np.clip(np.rint(255.0 * both), 0, 255).astype(np.uint8)[..., ::-1]
    cv2.imwrite(str(path), cv2.resize(codes, None, fx=6, fy=6, interpolation=cv2.INTER_NEAREST))


if __name__ == "__main__":
    sys.exit(main())
