# SPDX-License-Identifier: Apache-2.0
"""How quick the tuning page is, in a headless Chromium: python benchmarks/tune.py [section]

Sections: start (from the command to a page that can be used), slider (from a move to the new picture, at 1024 x 512),
scrub (from a step of the play head to the new picture, at 3840 x 1920), pictures (those of docs/tuning.md); default:
the first three. Browser and server share the machine.
"""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from mr360uw.sample import sample_dive
from tests.tune.browser import FLAGS, chromium

DOCS = Path(__file__).resolve().parents[1] / "docs"
MOVES = 50
TIMEOUT_MS = 120_000
TIMED = """([selector, act]) => new Promise((done) => {
  const began = performance.now();
  let [old, draft] = [false, null];
  const look = () => {
    const badge = document.querySelector(".uw-badge")?.textContent || "";
    if (badge.includes("older")) old = true;
    else if (old && draft === null && !badge.includes("keyframe")) draft = performance.now() - began;
    if (!old || badge) return;
    observer.disconnect();
    clearTimeout(late);
    done([draft, performance.now() - began]);
  };
  const observer = new MutationObserver(look);
  const late = setTimeout(() => { observer.disconnect(); done(null); }, 20000);
  observer.observe(document.querySelector(".uw-stage"), { childList: true, subtree: true, characterData: true });
  const element = document.querySelector(selector);
  if (act.key) element.dispatchEvent(new KeyboardEvent("keydown", { key: act.key, bubbles: true }));
  else {
    element.value = act.value;
    for (const name of ["input", "change"]) element.dispatchEvent(new Event(name, { bubbles: true }));
  }
})"""
"""Acts on an element; milliseconds until a draft of the new state, and until its full picture, is on the screen."""


@contextmanager
def tuned(scene: Path, size: tuple[int, int] = (1280, 800), mode: str = "dark") -> Iterator[tuple[Any, float]]:
    """Yield the page of a scene once it can be used, and the seconds since the command was started."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        context = browser.new_context(viewport={"width": size[0], "height": size[1]}, color_scheme=mode)
        page = context.new_page()
        page.set_default_timeout(TIMEOUT_MS)
        page.goto("about:blank")
        began = time.perf_counter()
        command = [sys.executable, "-m", "mr360uw", "tune", str(scene), "--port", "0", "--no-browser"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=dict(os.environ))
        try:
            assert server.stdout is not None
            page.goto(server.stdout.readline().strip())
            page.wait_for_selector(".control")
            yield page, time.perf_counter() - began
        finally:
            server.terminate()
            server.wait()
            browser.close()


def rest(page: Any) -> None:
    """Wait until the picture is of the present state, and the thumbnails are there."""
    page.wait_for_function("() => / ms$/.test(document.querySelector('.stage-bar > .status').textContent)")


def median_line(name: str, times: list[tuple[float, float]], targets: tuple[float, float]) -> None:
    """Print the medians of drafts and full pictures."""
    for words, column, target in (("draft", 0, targets[0]), ("full", 1, targets[1])):
        middle = statistics.median(one[column] for one in times)
        worst = sorted(one[column] for one in times)[int(0.9 * (len(times) - 1))]
        met = "met" if middle <= target else "missed"
        print(f"{name}, {words}: median {middle:.0f} ms, 90 % {worst:.0f} ms, target {target:.0f} ms: {met}")


def start(folder: Path) -> None:
    """Print how long the page takes to be usable, five times."""
    dive = sample_dive(folder / "start", width=1024, frames=24)
    times, firsts = [], []
    for _ in range(5):
        began = time.perf_counter()
        with tuned(dive.scene) as (page, seconds):
            times.append(seconds)
            rest(page)
            firsts.append(time.perf_counter() - began)
    print(
        f"usable: median {statistics.median(times):.1f} s, target 2 s; first picture {statistics.median(firsts):.1f} s"
    )


def slider(folder: Path) -> None:
    """Print the times of slider moves."""
    dive = sample_dive(folder / "slider", width=1024, frames=24)
    keys = {"object.0.roughness": "roughness", "sea.wind_speed": "wind_speed", "camera.depth_m": "depth_m"}
    with tuned(dive.scene) as (page, _):
        rest(page)
        for key, words in keys.items():
            page.get_by_label("Search parameters").fill(words)
            times = []
            for move in range(MOVES + 2):
                act = {"value": 0.2 + 0.4 * (move * 7 % MOVES) / MOVES}
                found = page.evaluate(TIMED, [f'[data-key="{key}"] input[type=range]', act])
                if move >= 2 and found is not None:  # the first two meet what is not made yet
                    times.append(found)
            median_line(f"slider {key}, {len(times)} moves", times, (120.0, 500.0))


def scrub(folder: Path) -> None:
    """Print the times of steps of the play head."""
    dive = sample_dive(folder / "scrub", width=3840, frames=8)
    with tuned(dive.scene) as (page, _):
        rest(page)
        times = []
        for step in range(24):
            key = "ArrowRight" if step % 12 < 6 else "ArrowLeft"
            found = page.evaluate(TIMED, [".uw-strip", {"key": key}])
            if step >= 2 and found is not None:
                times.append(found)
        median_line(f"scrubbing, {len(times)} steps", times, (250.0, 1000.0))


def pictures(folder: Path) -> None:
    """Make the pictures of docs/tuning.md."""
    dive = sample_dive(folder / "pictures", width=2048, frames=24)
    with tuned(dive.scene) as (page, _):
        rest(page)
        page.wait_for_timeout(4000)  # thumbnails
        page.screenshot(path=DOCS / "tuning-dark.jpg", type="jpeg", quality=88)
    with tuned(dive.scene, (1920, 1080), "light") as (page, _):
        rest(page)
        page.get_by_label("key Wind speed at this time").click()
        page.locator(".uw-strip").press("End")
        page.get_by_label("Wind speed", exact=True).fill("9")
        page.get_by_label("Wind speed", exact=True).press("Enter")
        page.locator(".uw-key").nth(1).wait_for()
        page.get_by_label("Width of the full picture").select_option("2048")
        page.get_by_label("Compare with", exact=True).select_option("plate")
        page.locator(".segments").get_by_role("button", name="All").click()
        page.locator("summary", has_text="Sea surface").click()
        rest(page)
        page.wait_for_timeout(4000)
        page.screenshot(path=DOCS / "tuning-light.jpg", type="jpeg", quality=88)


SECTIONS = {"start": start, "slider": slider, "scrub": scrub, "pictures": pictures}


def main() -> None:
    """Run the sections that are asked for."""
    wanted = [name for name in sys.argv[1:] if re.fullmatch("|".join(SECTIONS), name)] or ["start", "slider", "scrub"]
    with tempfile.TemporaryDirectory() as folder:
        for name in wanted:
            SECTIONS[name](Path(folder))


if __name__ == "__main__":
    main()
