# SPDX-License-Identifier: Apache-2.0
"""How quick the tuning page is, in a headless Chromium: python benchmarks/tune.py [section ...] [key ...]

Sections: start (from the command to a page that can be used), controls (from a move to the new picture, at 1024 x 512:
a table of all controls that a scene of `mr360uw new` shows first, or of the keys that are named), scrub (from a step of
the play head to the new picture, at 3840 x 1920), playback (frames a second of a clip that is played, in the first
and the second loop, at 1024 x 512). Browser and server share the machine.
"""

from __future__ import annotations

import itertools
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

MOVES = 50
OPTIONS = {
    "water.type": ['"IB"', '"II"', '"IA"'],
    "light.sun": ['"detect"', '"none"'],
    "object.0.face": ["90", '"camera"', "40"],
}
"""Values that a control of words is moved between, as it sends them; of others the last two that it offers."""
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
  if (act.flip) element.click();
  else if (act.key) element.dispatchEvent(new KeyboardEvent("keydown", { key: act.key, bubbles: true }));
  else {
    element.value = act.value;
    for (const name of ["input", "change"]) element.dispatchEvent(new Event(name, { bubbles: true }));
  }
})"""
"""Acts on an element; milliseconds until a draft of the new state, and until its full picture, is on the screen."""


@contextmanager
def tuned(scene: Path, size: tuple[int, int] = (1280, 800), mode: str = "dark") -> Iterator[tuple[Any, float, int]]:
    """Yield the page of a scene once it can be used, the seconds since the command was started, the server's number."""
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
            yield page, time.perf_counter() - began, server.pid
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
        with tuned(dive.scene) as (page, seconds, _):
            times.append(seconds)
            rest(page)
            firsts.append(time.perf_counter() - began)
    print(
        f"usable: median {statistics.median(times):.1f} s, target 2 s; first picture {statistics.median(firsts):.1f} s"
    )


def made_scene(folder: Path) -> Path:
    """Return a scene of the sample dive's clip and mesh as `mr360uw new` writes it."""
    dive = sample_dive(folder / "controls", width=1024, frames=24)
    scene = folder / "new.toml"
    command = [sys.executable, "-m", "mr360uw", "new", str(dive.plate), str(dive.mesh), "-o", str(scene)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return scene


def acts(page: Any, key: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what moves a control, again and again: the selector of its element, and what is done to it."""
    control = f'[data-key="{key}"]'
    element = f"{control} .control-body :is(input, select)"  # the first one, of a number its slider
    kind = page.evaluate("s => document.querySelector(s).type", element)
    values = OPTIONS.get(key)
    if kind == "select-one" and values is None:
        values = page.evaluate("s => [...document.querySelector(s).options].slice(-2).map(o => o.value)", element)
    start = 0.0 if kind != "number" else float(page.eval_on_selector(element, "e => e.value || 0"))
    for move in itertools.count():
        part = (move * 7 % MOVES) / MOVES
        if kind == "checkbox":
            yield element, {"flip": True}
        elif values is not None:
            yield element, {"value": values[move % len(values)]}
        else:
            yield element, {"value": 0.2 + 0.4 * part if kind == "range" else start + part}


def controls(folder: Path) -> None:
    """Print a table of the times of moves of controls, on the clock, and of the server's processor for a move."""
    with tuned(made_scene(folder)) as (page, seconds, server):
        print(f"usable {seconds:.1f} s after the command; load of the machine {os.getloadavg()[0]:.1f}")
        rest(page)
        shown = page.evaluate("() => [...document.querySelectorAll('.control')].map(one => one.dataset.key)")
        named = [name for name in sys.argv[1:] if "." in name]
        print("| control | draft | 95 % | full | 95 % | processor | |\n| --- | --- | --- | --- | --- | --- | --- |")
        snapshot(page, "Keep the present state")
        for key in named or shown:
            page.get_by_label("Search parameters").fill(key.rpartition(".")[2])
            page.wait_for_selector(f'[data-key="{key}"]')
            times, moves, before = [], acts(page, key), processor_s(server)
            for move in range(MOVES + 2):
                found = page.evaluate(TIMED, list(next(moves)))
                if move == 1:
                    before = processor_s(server)
                if move >= 2 and found is not None:  # the first two meet what is not made yet
                    times.append(found)
            used = 1e3 * (processor_s(server) - before) / MOVES
            print(table_row(key, times, used), flush=True)
            snapshot(page, "Back to snapshot 1")  # each control is moved from the same state


def snapshot(page: Any, item: str) -> None:
    """Choose from the page's menu of snapshots, and wait for the picture."""
    page.get_by_role("button", name="Snapshots").click()
    page.get_by_text(item, exact=True).click()
    page.wait_for_timeout(200)
    rest(page)


def processor_s(process: int) -> float:
    """Return the processor time [s] that a process has taken."""
    fields = Path(f"/proc/{process}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def table_row(key: str, times: list[tuple[float, float]], used_ms: float) -> str:
    """Return a line of the table: medians and 95th percentiles [ms] of drafts and full pictures."""
    if not times:
        return f"| `{key}` | | | | | {used_ms:.0f} | no new picture |"
    cells, missed = [], []
    for name, column, target in (("draft", 0, 120.0), ("full", 1, 500.0)):
        ordered = sorted(one[column] for one in times)
        middle = statistics.median(ordered)
        cells += [f"{middle:.0f}", f"{ordered[round(0.95 * (len(ordered) - 1))]:.0f}"]
        missed += [name] if middle > target else []
    lost = f", {MOVES - len(times)} moves without a picture" if len(times) < MOVES else ""
    words = "above: " + ", ".join(missed) if missed else ""
    return f"| `{key}` | {' | '.join(cells)} | {used_ms:.0f} | {words}{lost} |"


def scrub(folder: Path) -> None:
    """Print the times of steps of the play head."""
    dive = sample_dive(folder / "scrub", width=3840, frames=8)
    with tuned(dive.scene) as (page, *_):
        rest(page)
        times = []
        for step in range(24):
            key = "ArrowRight" if step % 12 < 6 else "ArrowLeft"
            found = page.evaluate(TIMED, [".uw-strip", {"key": key}])
            if step >= 2 and found is not None:
                times.append(found)
        median_line(f"scrubbing, {len(times)} steps", times, (250.0, 1000.0))


PLAYED = """(loops) => new Promise((done) => {
  const [strip, told] = [document.querySelector(".uw-strip"), []];
  let [last, began, pictures] = [0, performance.now(), 0];
  const count = (list) => { pictures += list.getEntries().filter((one) => one.name.includes("/picture/")).length; };
  new PerformanceObserver(count).observe({ entryTypes: ["resource"] });
  new MutationObserver(() => {
    const [now, time] = [Number(strip.getAttribute("aria-valuenow")), performance.now()];
    if (now < last) {
      told.push([pictures, (time - began) / 1000]);
      [began, pictures] = [time, 0];
      if (told.length === loops) done(told);
    }
    last = now;
  }).observe(strip, { attributes: true });
  document.querySelector("[aria-label='Play']").click();
})"""
"""Plays; pictures that came in each loop over the clip, and its seconds."""


def playback(folder: Path) -> None:
    """Print the frames a second of loops over a clip that plays."""
    dive = sample_dive(folder / "playback", width=1024, frames=48)
    with tuned(dive.scene) as (page, *_):
        rest(page)
        for loop, (pictures, seconds) in enumerate(page.evaluate(PLAYED, 3), 1):
            print(f"loop {loop}: {pictures} pictures in {seconds:.1f} s: {pictures / seconds:.1f} a second (24 wanted)")


SECTIONS = {"start": start, "controls": controls, "scrub": scrub, "playback": playback}


def main() -> None:
    """Run the sections that are asked for."""
    wanted = [name for name in sys.argv[1:] if re.fullmatch("|".join(SECTIONS), name)] or list(SECTIONS)
    with tempfile.TemporaryDirectory() as folder:
        for name in wanted:
            SECTIONS[name](Path(folder))


if __name__ == "__main__":
    main()
