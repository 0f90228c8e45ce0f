# SPDX-License-Identifier: Apache-2.0
"""The tuning page in a browser: one server and one browser for all tests, each from the scene as it was at first."""

from __future__ import annotations

import http.client
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from mr360uw.preview.live import LivePreview
from mr360uw.preview.screen import encoded
from mr360uw.sample import SampleDive
from mr360uw.scene.model import load_scene
from mr360uw.tune import placing
from mr360uw.tune.situation import Situation
from tests.gate import HANG_S
from tests.tune.browser import chromium, started

TOKEN = "for-tests"
WAIT_MS = 1000.0 * HANG_S
POLL_MS = 30
"""Between two looks at a page; by default Playwright looks at every frame, and has all of them drawn."""
WIDTH, HEIGHT = 256, 128
_NOTE_CLICKS = """() => document.querySelector('.uw-stage').addEventListener('pointerdown', event => {
  const box = document.querySelector('.uw-stage canvas').getBoundingClientRect();
  window.clicked = [event.clientX - box.x, event.clientY - box.y, box.width, box.height];
}, true)"""
"""Notes where in the picture a click was, and its size then: bars above it come and go."""


class Tab:
    """A tab of the page. asked: the addresses that it asked for. shown: numbers of the pictures of its stage."""

    def __init__(self, context: Any, address: str) -> None:
        self.page = context.new_page()
        self.page.set_default_timeout(WAIT_MS)
        self.asked: list[str] = []
        self.shown: list[int] = []
        self.wrong: list[str] = []
        self._last: tuple[int, bytes] = (-1, b"")  # picture that was fetched last, and its number
        self.page.on("request", self._note)
        self.page.on("websocket", lambda socket: self.asked.append(socket.url))
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.open(address)

    def _note(self, request: Any) -> None:
        self.asked.append(request.url)
        if "/picture/" in request.url and request.resource_type == "fetch":  # thumbnails are images
            self.shown.append(int(request.url.rsplit("/", 1)[1]))

    def open(self, address: str) -> None:
        """Load the page anew."""
        self.page.goto(address)
        self.page.wait_for_selector(".control")
        self.until("() => document.querySelector('.unsaved').textContent !== ''")

    def control(self, key: str) -> Any:
        """Find a control by its key, through the search."""
        self.page.get_by_label("Search parameters").fill(key.split(".")[-1])
        return self.page.locator(f'[data-key="{key}"]')

    def done(self) -> None:
        """Wait until the picture is of the present state."""
        self.until("e => / ms$/.test(e.textContent)", self.page.locator(".stage-bar > .status").element_handle())

    def picture(self) -> bytes:
        """Return the picture of the present state."""
        self.done()
        number = self.newest()
        if number != self._last[0]:
            self._last = number, bytes(self.page.request.get(f"/picture/{number}").body())
        return self._last[1]

    def newest(self) -> int:
        """Return the number of the picture that was asked for last, of whatever state."""
        return max(self.shown)

    def changed(self, before: bytes) -> None:
        """Wait until the picture is another one."""
        end = time.monotonic() + WAIT_MS / 1000
        while self.picture() == before:
            assert time.monotonic() < end, "the picture stays as it was"
            self.page.wait_for_timeout(20)

    def returned(self, before: bytes) -> None:
        """Wait until the picture is that of before again."""
        end = time.monotonic() + WAIT_MS / 1000
        while self.picture() != before:
            assert time.monotonic() < end, "the picture is not as it was before"
            self.page.wait_for_timeout(20)

    def until(self, what: str, arg: Any = None) -> None:
        """Wait until a function of the page returns true."""
        self.page.wait_for_function(what, arg=arg, polling=POLL_MS)


class Page:
    """The server, the browser and the first tab."""

    def __init__(self, browser: Any, scene: Path, address: str) -> None:
        self.browser, self.scene, self.address = browser, scene, address
        parts = urlsplit(address)
        self.base, self.port = f"http://{parts.netloc}", parts.port
        self.context = browser.new_context(
            viewport={"width": 1280, "height": 800}, base_url=self.base, reduced_motion="reduce"
        )
        self.tabs: list[Tab] = []
        self.first, self._text = self.tab(), scene.read_text("utf-8")
        self.first.page.get_by_role("button", name="Snapshots").click()
        self.first.page.get_by_text("Keep the present state", exact=True).click()

    def renew(self) -> None:
        """Load the first tab anew, with the scene as it was at first."""
        self.first.open(self.address)
        unsaved = self.first.page.locator(".unsaved").inner_text() != "saved"
        if unsaved or self.scene.read_text("utf-8") != self._text:
            self.first.page.get_by_role("button", name="Snapshots").click()
            self.first.page.get_by_text("Back to snapshot 1", exact=True).click()
            if self.scene.read_text("utf-8") != self._text:
                self.first.until("() => document.querySelector('.unsaved').textContent !== 'saved'")
            save(self.first)

    def tab(self) -> Tab:
        tab = Tab(self.context, self.address)
        self.tabs.append(tab)
        return tab


@pytest.fixture
def page(opened: Page) -> Page:
    opened.renew()
    return opened


@pytest.fixture(scope="module")
def opened(dive: SampleDive, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    chromium()
    folder = tmp_path_factory.mktemp("tune")
    for file in (dive.plate, dive.mesh):
        shutil.copy(file, folder)
    scene = folder / "scene.toml"
    scene.write_text(dive.scene.read_text("utf-8"), "utf-8")
    ours = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}  # NiceGUI looks for it
    ours["MR360UW_TOKEN"] = TOKEN
    ours["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    elsewhere = str(Path(folder.name) / scene.name)  # from another folder than the scene's
    command = [sys.executable, "-m", "mr360uw", "tune", elsewhere, "--port", "0", "--no-browser"]
    server = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=ours, cwd=folder.parent
    )
    try:
        assert server.stdout is not None
        address = server.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:"), address + server.stdout.read()
        with started() as browser:
            yield Page(browser, scene, address)
    finally:
        server.terminate()
        output, _ = server.communicate(timeout=60.0)
    assert "Traceback" not in output, output


def test_the_page_shows_the_scene(page: Page) -> None:
    tab = page.first
    assert tab.page.title() == "scene.toml - mr360uw"
    assert tab.page.locator("h1").inner_text() == "scene.toml"
    assert tab.control("camera.depth_m").get_by_label("Camera depth", exact=True).input_value() == "4"
    picture = tab.picture()
    assert picture[:2] == b"\xff\xd8"
    assert "256 x 128" in tab.page.locator(".stage-bar > .status").inner_text()
    assert len(picture) > 2000
    assert "token" not in tab.page.url


NUMBER, SLIDER, CHOICE, SWITCH, TEXT, COLOUR = "number", "slider", "choice", "switch", "text", "colour"


@pytest.mark.parametrize(
    ("key", "how", "given", "expected", "seen"),
    [
        ("camera.depth_m", NUMBER, "7.5", 7.5, True),
        ("water.visibility_m", SLIDER, "End", 90.0, True),
        ("draw.motion_samples", NUMBER, "2", 2, False),
        ("water.type", CHOICE, '"III"', "III", True),  # in place of the visibility
        ("object.0.visible", SWITCH, "", False, True),
        ("object.0.double_sided", CHOICE, "true", True, False),
        ("object.0.position_m", NUMBER, "-0.5", [-0.5, -0.6, -3.6], False),
        ("object.0.base_color", COLOUR, "#ff0000", [1.0, 0.0, 0.0], False),
        ("output.pixel_format", TEXT, "", None, False),
        ("water.gain", TEXT, "[1.0, 0.9, 0.8]", [1.0, 0.9, 0.8], False),
        ("light.sun_time", TEXT, "2026-06-21T12:00:00+00:00", "2026-06-21T12:00:00+00:00", False),
    ],
)
def test_every_kind_of_control_sets_its_parameter(
    page: Page, key: str, how: str, given: str, expected: Any, seen: bool
) -> None:
    tab, before = page.first, page.first.picture()
    control = tab.control(key)
    if how == NUMBER:
        control.locator("input[type=number]").first.fill(given)
        control.locator("input[type=number]").first.press("Enter")
    elif how == SLIDER:
        control.locator("input[type=range]").press(given)
    elif how == CHOICE:
        control.locator("select").select_option(given)
    elif how == SWITCH:
        control.locator("input").click()
    elif how == COLOUR:
        control.locator("input[type=color]").fill(given)
        control.locator("input[type=color]").dispatch_event("change")
    else:
        control.locator("input").fill(given)
        control.locator("input").press("Enter")
    if expected is None:
        return
    tab.page.locator(f"button[title='undo: set {key}']").wait_for()  # the document has it
    assert control.locator(".error").count() == 0
    if seen:
        tab.changed(before)
    tab.page.keyboard.press("Control+s")
    tab.until("() => document.querySelector('.unsaved').textContent === 'saved'")
    found: Any = load_scene(page.scene)
    for part in key.split("."):
        found = found[int(part)] if part.isdecimal() else getattr(found, {"object": "objects"}.get(part, part))
    assert (list(found) if isinstance(found, tuple) else found) == expected


def test_a_place_is_said_in_the_words_that_are_set(page: Page) -> None:
    tab = page.first
    tab.done()
    azimuth = tab.control("object.0.azimuth_deg").locator("input[type=number]")
    tab.until("e => e.value !== '' && Number(e.value) !== 0", azimuth.element_handle())  # as it is
    before = tab.picture()
    azimuth.fill("40")
    azimuth.press("Enter")
    tab.page.locator("button[title='undo: set object.0.azimuth_deg']").wait_for()
    assert tab.page.locator(".problems").count() == 0
    tab.changed(before)
    control = tab.control("object.0.position_m")
    control.locator(".mark").wait_for(state="detached")
    tab.page.keyboard.press("Control+s")
    tab.until("() => document.querySelector('.unsaved').textContent === 'saved'")
    (first, *_) = load_scene(page.scene).objects
    assert first.azimuth_deg == 40.0
    assert "position_m" not in first.model_fields_set
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+z")
    control.locator(".mark").wait_for()  # it is a position again


def test_a_control_without_effect_says_why(page: Page) -> None:
    control = page.first.control("snow.exponent")
    assert control.locator(".why").inner_text() == "No effect while amount is 0"
    assert page.first.control("sea.wind_speed").locator(".why").count() == 0


WORDS = {
    "murky": "water.visibility_m", "fog": "water.visibility_m", "haze": "water.visibility_m", "clear": "water.type",
    "visibility": "water.visibility_m", "green": "water.type", "blue": "water.type", "tint": "object.0.tint",
    "colour": "object.0.tint", "brightness": "light.exposure", "exposure": "light.exposure", "dark": "light.exposure",
    "light": "light.exposure", "sunlight": "light.sun", "rays": "shafts.strength", "god rays": "shafts.strength",
    "beams": "shafts.strength", "sparkle": "caustics.enabled", "ripples": "caustics.enabled",
    "waves": "sea.wind_speed", "wind": "sea.wind_speed", "calm": "sea.wind_speed", "surface": "sea.wind_speed",
    "shadow": "receiver.shadow", "soft shadow": "draw.sun_spread_deg", "depth": "camera.depth_m",
    "deep": "camera.depth_m", "distance": "object.0.distance_m", "far": "water.visibility_m",
    "size": "object.0.size_m", "big": "object.0.size_m", "scale": "object.0.scale", "turn": "object.0.rotation_deg",
    "rotate": "object.0.rotation_deg", "face": "object.0.face", "move": "object.0.position_m",
    "position": "object.0.position_m", "swim": "object.0.animation", "speed": "object.0.speed",
    "animation": "object.0.animation", "loop": "object.0.loop", "transparent": "object.0.mesh",
    "glass": "object.0.roughness", "shiny": "object.0.roughness", "matte": "object.0.roughness",
    "rough": "object.0.roughness", "texture": "object.0.texture", "plankton": "snow.amount", "particles": "snow.amount",
    "noise": "draw.grain", "grain": "draw.grain", "sharp": "match.sharpening", "blur": "match.softness",
    "mask": "add to Mattes", "floor": "receiver.height_m", "sand": "receiver.height_m", "lamp": "add to Lamps",
    "torch": "add to Lamps", "quality": "draw.quality", "resolution": "Render …", "save": "Save",
    "render": "Render frame",
}  # fmt: skip
"""What is meant by everyday words: a parameter, or the text or label of a button."""
_FOUND = """async (words) => {
  const field = document.querySelector("input[type=search]");
  const found = {};
  for (const word of words) {
    field.value = word;
    field.dispatchEvent(new Event("input"));
    await new Promise(requestAnimationFrame);
    const all = [...document.querySelectorAll(".controls-list :is([data-key], .action, .add)")];
    found[word] = all.slice(0, 3).map((one) => one.dataset.key || one.ariaLabel || one.textContent);
  }
  return found;
}"""
"""Types words into the search; returns the first three results of each."""


def test_everyday_words_find_what_is_meant(page: Page, subtests: pytest.Subtests) -> None:
    found = page.first.page.evaluate(_FOUND, list(WORDS))
    assert all(one.startswith("water.") for one in found["fog"])
    for word, meant in WORDS.items():
        with subtests.test(word):
            assert meant in found[word]


def test_a_phone_shows_picture_and_controls(page: Page) -> None:
    phone = page.browser.new_context(viewport={"width": 400, "height": 800}, base_url=page.base).new_page()
    phone.goto(page.address)
    control, picture = phone.locator(".control").first, phone.locator(".stage-picture")
    control.wait_for()
    for part in (control, picture):
        box = part.bounding_box()
        assert box is not None
        assert box["x"] >= 0.0
        assert box["x"] + box["width"] <= 400.0
        assert box["y"] + 40.0 <= 800.0
    assert phone.evaluate("document.documentElement.scrollWidth") <= 400
    phone.close()


def test_undo_and_reset_go_back(page: Page) -> None:
    tab = page.first
    control = tab.control("object.0.visible")
    control.locator("input").click()
    control.locator(".mark").wait_for()
    control.locator(".reset").click()
    control.locator(".mark").wait_for(state="detached")
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+z")
    control.locator(".mark").wait_for()
    tab.page.keyboard.press("Control+Shift+z")
    control.locator(".mark").wait_for(state="detached")


def test_an_invalid_value_is_told_beside_its_control_and_the_picture_stays(page: Page) -> None:
    tab, before = page.first, page.first.picture()
    control = tab.control("camera.depth_m")
    number = control.locator("input[type=number]")
    number.fill("-3")
    number.press("Enter")
    control.locator(".error").wait_for()
    assert "must be > 0 and <= 200 m" in control.locator(".error").inner_text()
    assert number.get_attribute("aria-invalid") == "true"
    tab.page.locator(".page-notices .problems").wait_for()
    tab.page.keyboard.press("Control+s")  # what gives no scene is not saved
    tab.page.locator(".q-notification").first.wait_for()
    assert load_scene(page.scene).camera.depth_m == 4.0
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+z")
    control.locator(".error").wait_for(state="detached")
    tab.returned(before)


def test_two_tabs_stay_in_step(page: Page) -> None:
    first, second = page.first, page.tab()
    first.control("camera.depth_m").locator("input[type=number]").fill("6.25")
    first.page.keyboard.press("Enter")
    field = second.control("camera.depth_m").locator("input[type=number]")
    second.until("e => e.value === '6.25'", field.element_handle())
    field.fill("4.5")
    field.press("Enter")
    other = first.control("camera.depth_m").locator("input[type=number]")
    first.until("e => e.value === '4.5'", other.element_handle())
    second.returned(first.picture())
    second.page.close()


def test_looking_around_stays_while_pictures_change(page: Page) -> None:
    tab = page.first
    look = tab.page.get_by_role("button", name="Look around")
    look.click()
    canvas = tab.page.locator(".uw-stage canvas")
    canvas.focus()
    tab.page.keyboard.press("ArrowRight")
    tab.control("camera.depth_m").locator("input[type=number]").fill("5")
    tab.page.keyboard.press("Enter")
    tab.done()
    assert look.get_attribute("aria-pressed") == "true"
    tab.page.get_by_role("button", name="Flat").click()


def test_the_list_of_comparisons_follows_the_viewer(page: Page) -> None:
    tab = page.first
    chosen = tab.page.get_by_label("Compare with", exact=True)
    bar = tab.page.get_by_label("Compare with a second picture")
    for button, expected in (("Snapshot", ""), ("Wipe", "snapshot"), ("One", "")):
        bar.get_by_role("button", name=button, exact=True).click()
        tab.until("([e, v]) => e.value === v", [chosen.element_handle(), expected])
    chosen.select_option("plate")
    bar.get_by_role("button", name="Wipe", exact=True, pressed=True).wait_for()
    assert chosen.input_value() == "plate"
    bar.get_by_role("button", name="One", exact=True).click()
    tab.until("e => e.value === ''", chosen.element_handle())


def test_the_clip_is_measured_on_request(page: Page) -> None:
    tab = page.first
    assert "light of the clip" not in tab.page.locator(".stage-bar > .status").inner_text()
    tab.page.get_by_role("button", name="Measure clip").click()
    tab.page.locator(".stage-bar > .status", has_text="light of the clip").wait_for()
    tab.page.get_by_role("button", name="Measure clip", pressed=False).wait_for()


def test_depth_is_not_looked_for_without_a_scale(page: Page) -> None:
    tab = page.first
    tab.page.get_by_role("button", name="Find depth").click()
    tab.page.get_by_text("distances have no scale").wait_for()
    tab.page.get_by_role("button", name="Close", exact=True).first.click()
    assert tab.page.get_by_role("button", name="Find depth").get_attribute("aria-pressed") != "true"


def test_an_object_stands_where_the_picture_is_clicked(page: Page) -> None:
    tab = page.first
    tab.page.get_by_label("What a click in the picture does").select_option("stand")
    tab.done()
    box = tab.page.locator(".uw-stage canvas").bounding_box()
    assert box is not None
    x, y = round(box["x"] + 0.31 * box["width"]), round(box["y"] + 0.7 * box["height"])
    old = tab.control("object.0.position_m").locator("input").first.input_value()
    tab.page.mouse.click(x, y)
    first = tab.control("object.0.position_m").locator("input").first
    tab.until("([e, old]) => e.value !== old", [first.element_handle(), old])
    tab.page.keyboard.press("Control+s")
    tab.until("() => document.querySelector('.unsaved').textContent === 'saved'")
    with LivePreview("reference") as preview:
        here = Situation(preview, load_scene(page.scene), 0, 0.0)
    body = here.bodies[0]
    foot = body.position + placing.foot(*body.shape)
    u, v = placing.pixel_of_point(placing.shown_at(here.camera, foot)[0], WIDTH, HEIGHT)
    size = min(box["width"] / WIDTH, box["height"] / HEIGHT)  # screen pixels of one of the picture
    at_x = box["x"] + 0.5 * box["width"] + size * (u - 0.5 * WIDTH)
    at_y = box["y"] + 0.5 * box["height"] + size * (v - 0.5 * HEIGHT)
    # positions are kept to 0.1 mm; a click is at a whole pixel
    np.testing.assert_allclose([at_x, at_y], [x, y], atol=1.0)


@pytest.mark.parametrize(("word", "size"), [("size_m", 0.402), ("scale", 2.5)])
def test_a_handle_scales_the_size_as_the_scene_says_it(page: Page, word: str, size: float) -> None:
    """An arrow key on the handle is a drag that makes an object larger by 2 %."""
    tab = page.first
    handle = tab.page.locator(".uw-handle.uw-scale")
    handle.wait_for()
    before = handle.bounding_box()
    assert before is not None
    control = tab.control(f"object.0.{word}").locator("input[type=number]")
    control.fill(str(size))
    control.press("Enter")
    tab.page.locator(f"button[title='undo: set object.0.{word}']").wait_for()
    moved = "([e, x]) => Math.abs(e.getBoundingClientRect().x - x) > 2"  # it is where this size ends
    tab.until(moved, [handle.element_handle(), before["x"]])
    handle.press("ArrowRight")
    tab.page.locator("button[title='undo: scale object.0']").wait_for()
    save(tab)
    (body, *_) = load_scene(page.scene).objects
    assert getattr(body, word) == pytest.approx(1.02 * size, rel=1e-3)  # four digits are kept
    tab.page.keyboard.press("Control+z")
    tab.page.locator("button[title='redo: scale object.0']").wait_for()
    tab.page.keyboard.press("Control+z")
    tab.page.locator(f"button[title='redo: set object.0.{word}']").wait_for()
    save(tab)


def place(tab: Tab, u: float, v: float) -> tuple[float, float]:
    """Return where a place of the picture, given as fractions of it, is on the screen."""
    box = tab.page.locator(".uw-stage canvas").bounding_box()
    assert box is not None
    size = min(box["width"] / WIDTH, box["height"] / HEIGHT)  # screen pixels of one of the picture
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    return x + size * WIDTH * (u - 0.5), y + size * HEIGHT * (v - 0.5)


def draw(tab: Tab, *places: tuple[float, float]) -> None:
    """Draw a line with the mouse."""
    first, *others = (place(tab, *one) for one in places)
    tab.page.mouse.move(*first)
    tab.page.mouse.down()
    for one in others:
        tab.page.mouse.move(*one, steps=4)
    tab.page.mouse.up()


def save(tab: Tab) -> None:
    """Save the scene, where it is not: a save that nothing shows could meet what the test writes next."""
    tab.done()
    tab.page.locator("h1").click()
    if tab.page.locator(".unsaved").text_content() != "saved":
        tab.page.keyboard.press("Control+s")
    tab.until("() => document.querySelector('.unsaved').textContent === 'saved'")


def matte_of(page: Page) -> str:
    """Save the scene and return what its only holdout names."""
    tab = page.first
    save(tab)
    (one,) = load_scene(page.scene).holdouts
    return one.path.relative_to(page.scene.parent).as_posix()


def test_a_matte_is_drawn_at_keys_of_the_clip(page: Page) -> None:
    """Clicks around the sun in the first frame, strokes over it and beside it in the last one."""
    tab = page.first
    tab.page.get_by_label("What a click in the picture does").select_option("lasso")
    make = tab.page.get_by_role("button", name="Make matte")
    make.wait_for()
    tab.done()
    for u, v in ((0.4, 0.05), (0.7, 0.05), (0.7, 0.3), (0.4, 0.3)):  # the sun, and the sky about it
        assert not make.is_enabled() or v == 0.3
        tab.page.mouse.click(*place(tab, u, v))
    make.click()
    tab.page.locator("button[title='undo: add holdout']").wait_for()
    tab.page.locator("path.uw-drawn.uw-matte").first.wait_for(state="attached")
    assert matte_of(page) == "matte-1/key-0000.png"
    tab.page.locator(".uw-strip").press("End")
    tab.until("() => document.querySelector('.uw-time .uw-where').textContent.includes('frame 7')")
    key = tab.page.get_by_role("button", name="Make key")
    key.wait_for()
    for kind, line in (("inside", ((0.5, 0.17), (0.56, 0.17))), ("outside", ((0.35, 0.05), (0.35, 0.4)))):
        tab.page.get_by_label("What a line is drawn over").select_option(kind)
        draw(tab, *line)
        tab.page.locator(f"path.uw-drawn.uw-{kind}").wait_for(state="attached")
    key.click()
    tab.page.locator("button[title='undo: set holdout.0.path']").wait_for()
    tab.page.get_by_text("2 drawn · keys: 0, 7", exact=True).wait_for()
    assert matte_of(page) == "matte-1/%04d.png"
    assert len(list((page.scene.parent / "matte-1").glob("[0-9]*.png"))) == 8
    tab.page.get_by_role("button", name="Remove key").click()
    tab.page.get_by_text("2 drawn · keys: 0", exact=True).wait_for()
    assert matte_of(page) == "matte-1/key-0000.png"
    tab.page.locator(".uw-strip").press("Home")
    tab.page.get_by_label("What a click in the picture does").select_option("")
    for _ in range(3):
        tab.page.locator("h1").click()
        tab.page.keyboard.press("Control+z")
    tab.page.locator("button[title='undo: add holdout']").wait_for(state="detached")


def test_pictures_that_were_not_drawn_here_stay(page: Page) -> None:
    """A sequence that another program made lies where the page would put its own."""
    tab, folder = page.first, page.scene.parent / "matte-9"
    save(tab)
    folder.mkdir()
    foreign = encoded(np.full((HEIGHT, WIDTH, 3), 90, np.uint8), ".png")
    for index in range(8):
        (folder / f"{index:04d}.png").write_bytes(foreign)
    (folder / "key-0000.png").write_bytes(foreign)
    before = page.scene.read_text("utf-8")
    page.scene.write_text(f'{before}\n[[holdout]]\npath = "matte-9/%04d.png"\n', "utf-8")
    tab.page.get_by_label("What a click in the picture does").select_option("lasso")
    tab.page.get_by_label("Which matte is drawn").select_option("matte-9")
    tab.page.get_by_label("What a line is drawn over").select_option("outline")
    tab.done()
    for u, v in ((0.4, 0.05), (0.7, 0.05), (0.7, 0.3), (0.4, 0.3)):  # around the sun
        tab.page.mouse.click(*place(tab, u, v))
    tab.page.get_by_role("button", name="Make it again").click()
    tab.page.get_by_text("is no matte that was drawn here").first.wait_for()
    assert {file.read_bytes() for file in folder.iterdir()} == {foreign}
    tab.page.get_by_label("What a click in the picture does").select_option("")
    page.scene.write_text(before, "utf-8")
    tab.page.locator("button[title='undo: changed by another program']").wait_for()
    tab.until("() => !document.querySelector('select[title=\"Which matte is drawn\"]').textContent.includes('matte-9')")


def test_the_camera_is_levelled_by_clicks_on_the_horizon(page: Page) -> None:
    tab, before = page.first, page.first.picture()
    tab.page.get_by_label("What a click in the picture does").select_option("level")
    level = tab.page.get_by_role("button", name="Level camera")
    level.wait_for()
    for u, v in ((0.5, 0.5), (0.75, 0.52)):  # to the right lower by 3.6 degrees: it is rolled to the left
        tab.page.mouse.click(*place(tab, u, v))
        tab.page.locator(".uw-mark.uw-spot").nth(0 if u == 0.5 else 1).wait_for()
    level.click()
    tab.page.locator("button[title='undo: level by the horizon']").wait_for()
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+s")
    tab.until("() => document.querySelector('.unsaved').textContent === 'saved'")
    camera = load_scene(page.scene).camera
    np.testing.assert_allclose([camera.roll_deg, camera.pitch_deg], [-3.6, 0.0], atol=0.3)  # clicks at whole pixels
    tab.page.get_by_label("What a click in the picture does").select_option("")
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+z")
    tab.page.locator("button[title='undo: level by the horizon']").wait_for(state="detached")
    tab.returned(before)


def test_an_object_is_trimmed_by_thirds_of_a_stop(page: Page) -> None:
    tab = page.first
    number = tab.control("object.0.exposure").locator("input[type=number]")
    tab.page.get_by_role("button", name="Brighter").click()
    tab.until("e => e.value === '0.333'", number.element_handle())
    tab.page.locator("h1").click()
    for key, expected in ((".", "0.667"), (",", "0.333"), (",", "0"), (",", "-0.333")):
        tab.page.keyboard.press(key)
        tab.until("([e, v]) => e.value === v", [number.element_handle(), expected])
    for _ in range(5):
        tab.page.keyboard.press("Control+z")
    tab.page.locator("button[title='undo: set object.0.exposure']").wait_for(state="detached")


def test_keys_are_set_edited_and_played(page: Page) -> None:
    tab = page.first
    control, before = tab.control("sea.wind_speed"), tab.picture()
    control.get_by_label("key Wind speed at this time").click()
    tab.page.locator(".uw-key").first.wait_for()
    tab.page.locator(".uw-strip").press("End")
    tab.until("() => document.querySelector('.uw-time .uw-where').textContent.includes('frame 7')")
    tab.changed(before)
    control.locator("input[type=number]").fill("9")
    control.locator("input[type=number]").press("Enter")
    tab.page.locator(".uw-key").nth(1).wait_for()
    last = tab.page.locator(".uw-key").nth(1)
    last.press("ArrowLeft")  # the key goes a frame back
    tab.until("() => /0\\.2\\d s/.test(document.querySelectorAll('.uw-key')[1].getAttribute('aria-label'))")
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+s")
    tab.until("() => document.querySelector('.unsaved').textContent === 'saved'")
    (key,) = load_scene(page.scene).keys
    assert (key.parameter, key.value) == ("sea.wind_speed", (3.0, 9.0))
    np.testing.assert_allclose(key.time_s, [0.0, 6.0 / 24.0], atol=1e-5)  # rounded to microseconds
    tab.page.locator(".uw-strip").press("Home")
    tab.done()
    before, end = tab.newest(), time.monotonic() + WAIT_MS / 1000
    tab.page.get_by_role("button", name="Play").click()
    while tab.newest() == before:  # on a busy machine a clip that plays has never the picture of its present state
        assert time.monotonic() < end, "the picture stays as it was"
        tab.page.wait_for_timeout(20)
    tab.page.get_by_role("button", name="Pause").click()
    tab.page.get_by_role("button", name="Play").wait_for()
    tab.page.locator(".uw-strip").press("Home")  # whatever frame it was paused at, what follows begins at the first
    tab.until("() => document.querySelector('.uw-time .uw-where').textContent.includes('frame 0')")
    tab.done()


def test_a_preset_is_one_step(page: Page) -> None:
    tab = page.first
    tab.page.get_by_role("button", name="Presets").click()
    tab.page.locator(".q-menu").get_by_text("harbour", exact=True).click()
    choice = tab.control("water.type").locator("select")
    tab.until("e => e.value === '\"harbour\"'", choice.element_handle())
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+z")
    tab.until("e => e.value === '\"IB\"'", choice.element_handle())


def test_water_is_matched_by_a_click_and_undone(page: Page) -> None:
    """The plate's water is IB; the scene's is III."""
    tab, before = page.first, page.first.picture()
    choice = tab.control("water.type").locator("select")
    choice.select_option('"III"')
    tab.changed(before)
    before = tab.picture()
    tab.page.get_by_label("What a click in the picture does").select_option("water")
    canvas = tab.page.locator(".uw-stage canvas")
    box = canvas.bounding_box()
    assert box is not None
    # a little above the horizon, a quarter turn to the left of the whale
    tab.page.mouse.click(box["x"] + 0.25 * box["width"], box["y"] + 0.46 * box["height"])
    dialog = tab.page.get_by_label("Match", exact=True)
    dialog.locator(".swatch").nth(2).wait_for()
    colours = [_rgb(text) for text in dialog.locator("figcaption").all_inner_texts()]
    plate, was, now = colours
    assert np.abs(now - plate).max() < np.abs(was - plate).max()
    assert re.search(r"Deviation from the plate: [\d.]+ codes before, [\d.]+ after", dialog.inner_text())
    (line,) = [one for one in dialog.inner_text().splitlines() if one.startswith("water.type")]
    found = line.split(" → ")[1]
    assert line == f"water.type: III → {found}"
    assert found in ("IA", "IB", "II")  # a step from the truth: the depth in the scene is another
    dialog.get_by_role("button", name="Apply").click()
    tab.until("([e, v]) => e.value === v", [choice.element_handle(), f'"{found}"'])
    dialog.get_by_role("button", name="Close").click()
    tab.changed(before)
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+z")
    tab.until("e => e.value === '\"III\"'", choice.element_handle())
    tab.page.get_by_label("What a click in the picture does").select_option("")
    tab.returned(before)


def test_a_click_says_what_is_black_and_how_far_away(page: Page) -> None:
    """Open water is no black thing: the picture changes, and the patch is where the click was."""
    tab, before = page.first, page.first.picture()
    tab.page.get_by_label("What a click in the picture does").select_option("black")
    distance = tab.page.get_by_label("Distance of what is clicked, in metres")
    distance.wait_for()
    tab.page.evaluate(_NOTE_CLICKS)
    canvas = tab.page.locator(".uw-stage canvas")
    for given in ("a lot", "2.5"):
        distance.fill(given)
        distance.press("Enter")
        box = canvas.bounding_box()
        assert box is not None
        canvas.click(position={"x": 0.25 * box["width"], "y": 0.56 * box["height"]})
        if given == "a lot":
            tab.page.get_by_text("distance - is no length (got 'a lot')").wait_for()
            assert tab.page.locator("button[title='undo: add match.patch']").count() == 0
    tab.page.locator("button[title='undo: add match.patch']").wait_for()
    tab.changed(before)
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+s")
    tab.until("() => document.querySelector('.unsaved').textContent === 'saved'")
    (patch,) = load_scene(page.scene).match.patch
    x, y, width, height = tab.page.evaluate("() => window.clicked")
    size = min(width / WIDTH, height / HEIGHT)  # screen pixels of one of the picture
    there = 360.0 * (x - 0.5 * width) / size / WIDTH, 180.0 * (0.5 * height - y) / size / HEIGHT
    # a click is at a whole pixel of the screen
    np.testing.assert_allclose([patch.azimuth_deg, patch.elevation_deg], there, atol=360.0 / WIDTH / size)
    (frame,) = re.findall(r"frame (\d+)", tab.page.locator(".uw-time .uw-where").first.inner_text())
    assert (patch.shows, patch.distance_m, patch.time_s) == ("black", 2.5, round(int(frame) / 24.0, 6))
    tab.page.get_by_role("button", name="Forget patches").click()
    tab.page.locator("button[title='undo: reset match.patch']").wait_for()
    tab.page.get_by_label("What a click in the picture does").select_option("")
    distance.wait_for(state="hidden")
    tab.returned(before)
    tab.page.locator("h1").click()
    tab.page.keyboard.press("Control+s")
    tab.until("() => document.querySelector('.unsaved').textContent === 'saved'")


def _rgb(text: str) -> np.ndarray:
    """Return the code values of a line like "plate: 1, 2, 3"."""
    return np.array([int(one) for one in re.findall(r"\d+", text)])


def test_caustics_that_cannot_be_matched_say_why(page: Page) -> None:
    """The clip of eight frames is too short; nothing can be applied."""
    tab = page.first
    tab.page.get_by_role("button", name="Match caustics").click()
    dialog = tab.page.get_by_label("Match", exact=True)
    dialog.get_by_text("Nothing is matched").wait_for()
    assert "too short a time" in dialog.locator(".match-text").inner_text()
    assert dialog.get_by_role("button", name="Apply").is_disabled()
    dialog.get_by_role("button", name="Close").click()


def test_a_scene_broken_by_another_program_shows_why_and_the_last_picture(page: Page) -> None:
    tab, before, good = page.first, page.first.picture(), page.scene.read_text("utf-8")
    page.scene.write_text("plate = [", "utf-8")
    tab.page.locator(".page-notices .problems").get_by_text("is not TOML").wait_for()
    assert tab.picture() == before
    page.scene.write_text(good + "\n# again\n", "utf-8")
    tab.page.locator(".page-notices .problems").wait_for(state="detached")
    tab.returned(before)


def test_others_are_refused(page: Page) -> None:
    fresh = page.browser.new_context(base_url=page.base)
    for path in ("/", "/picture/1", "/?token=wrong", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"):
        assert fresh.request.get(path).status == 403
    fresh.close()
    known = {"Cookie": "; ".join(f"{one['name']}={one['value']}" for one in page.context.cookies())}
    socket = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
              "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}  # fmt: skip
    for headers, expected in (
        (known, 200), (known | {"Origin": "http://evil.example"}, 403), (known | {"Host": "evil.example"}, 403),
        (known | socket | {"Origin": "http://evil.example"}, 403), (known | socket | {"Origin": page.base}, 101),
    ):  # fmt: skip
        connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=20.0)
        path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket" if "Upgrade" in headers else "/"
        connection.request("GET", path, headers=headers)
        assert connection.getresponse().status == expected, headers
        connection.close()


def test_a_local_file_that_leads_to_the_address_opens_the_page(page: Page, tmp_path: Path) -> None:
    """As the file does with which the browser is started."""
    (tmp_path / "door.html").write_text(f'<meta http-equiv="refresh" content="0; url={page.address}">', "utf-8")
    fresh = page.browser.new_context()
    tab = fresh.new_page()
    tab.goto((tmp_path / "door.html").as_uri())
    tab.wait_for_url(f"{page.base}/")
    tab.locator("h1").get_by_text("scene.toml").wait_for()
    fresh.close()


def test_the_whole_clip_is_rendered_from_the_page(page: Page) -> None:
    tab = page.first
    tab.page.get_by_role("button", name="Render …").click()
    tab.page.get_by_role("textbox", name="Output").fill("from_page.mp4")
    tab.page.get_by_role("button", name="Render", exact=True).click()
    link = tab.page.get_by_role("link", name="Open from_page.mp4").get_attribute("href")
    tab.until("() => /^Done/.test(document.querySelector('.run-text').textContent)")
    assert (page.scene.parent / "from_page.mp4").stat().st_size > 1000
    assert tab.page.request.get(link, headers={"Range": "bytes=0-99"}).status == 206
    tab.page.get_by_role("form", name="Render").get_by_role("button", name="Close").click()


def test_the_output_is_beside_the_scene_by_default(page: Page) -> None:
    """As `mr360uw new` names it, wherever the page was started."""
    tab, expected = page.first, page.scene.with_suffix(".composite.mp4")
    output = tab.page.get_by_role("textbox", name="Output")
    for shown, typed in ((str(expected), "typed.mp4"), ("typed.mp4", str(expected))):  # what was typed stays
        tab.page.get_by_role("button", name="Render …").click()
        assert output.input_value() == shown
        output.fill(typed)
        tab.page.get_by_role("form", name="Render").get_by_role("button", name="Close").click()
    tab.page.get_by_role("button", name="Render …").click()
    tab.page.get_by_role("button", name="Render", exact=True).click()
    tab.page.get_by_role("link", name=f"Open {expected.name}").wait_for()
    assert expected.stat().st_size > 500


def test_a_picture_has_room_and_save_is_in_sight(page: Page) -> None:
    tab, save_button = page.first, page.first.page.get_by_role("button", name="Save", exact=True)
    tab.control("sea.wind_speed").get_by_label("key Wind speed at this time").click()
    tab.page.locator(".uw-key").wait_for()
    box = tab.page.locator(".uw-stage canvas").bounding_box()
    assert box is not None
    assert min(box["width"], 2.0 * box["height"]) >= 0.6 * 1280  # the picture is twice as wide as high
    tab.page.set_viewport_size({"width": 400, "height": 800})
    tab.until("e => e.getBoundingClientRect().right <= 400", save_button.element_handle())
    tab.page.locator(".page-header").evaluate("e => e.scrollLeft = 1000")
    tab.until("e => e.getBoundingClientRect().left >= 0", save_button.element_handle())
    tab.page.set_viewport_size({"width": 1280, "height": 800})


def test_what_is_opened_is_closed_by_its_button_and_by_escape(page: Page) -> None:
    tab = page.first
    tool, bar = tab.page.get_by_label("What a click in the picture does"), tab.page.locator(".stage-tools")
    depth, dialog = tab.page.get_by_role("button", name="Find depth"), tab.page.get_by_label("Find depth", exact=True)
    tab.control("camera.track").locator("input").fill("track.csv")
    track = "time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n"
    (page.scene.parent / "track.csv").write_text(track, "utf-8")
    tab.page.keyboard.press("Enter")
    tab.page.locator("button[title='undo: set camera.track']").wait_for()
    for by_key in (False, True):

        def close(button: Any, by_key: bool = by_key) -> None:
            tab.page.keyboard.press("Escape") if by_key else button.click()

        tool.select_option("floor")
        bar.get_by_role("button", name="Close", exact=True).wait_for()
        close(bar.get_by_role("button", name="Close", exact=True))
        tab.until("e => e.value === ''", tool.element_handle())
        tab.control("sea.wind_speed").get_by_label("key Wind speed at this time").click()
        tab.page.locator(".uw-key").wait_for()
        tab.page.locator("h1").click()
        close(tab.page.get_by_role("button", name="Close curve"))
        tab.page.locator(".uw-key").wait_for(state="detached")
        tab.page.keyboard.press("Control+z")
        depth.click()
        dialog.get_by_text("all 8 about 1 min").wait_for()  # and what it changes
        assert "plate.depth" in dialog.inner_text()
        close(dialog.get_by_role("button", name="Close"))
        tab.page.locator(".q-dialog").wait_for(state="detached")
    tab.page.keyboard.press("h")
    tab.page.locator(".uw-mark").first.wait_for(state="detached")


def test_handles_keep_the_words_of_the_file(page: Page) -> None:
    """Two objects by azimuth; the second is chosen by a click on it, moved, brought nearer and turned."""
    tab, text = page.first, page.scene.read_text("utf-8")
    said = "distance_m = 2.0\nsize_m = 1.2\nface = 40.0\n"
    before, _, rest = text.partition("[[object]]")
    after = rest[rest.index("\n[") :]
    bodies = [f'[[object]]\nmesh = "whale.glb"\nazimuth_deg = {azimuth}\n{said}' for azimuth in (-60.0, 60.0)]
    page.scene.write_text(before + "\n".join(bodies) + after, "utf-8")
    tab.page.locator(".uw-mark.uw-object").nth(1).wait_for()
    tab.done()
    tab.page.mouse.click(*place(tab, 0.5 + 60.0 / 360.0, 0.5))
    chosen = tab.page.locator(".uw-mark.uw-object").nth(1).element_handle()
    tab.until("e => e.classList.contains('uw-selected')", chosen)
    tab.page.get_by_label("move whale: drag, or arrow keys").press("ArrowRight")
    tab.page.locator("button[title='undo: move object.1']").wait_for()
    tab.page.mouse.move(*place(tab, 0.5 + 60.5 / 360.0, 0.5))
    tab.page.mouse.wheel(0, -100)
    tab.page.wait_for_timeout(600)
    tab.page.locator(".uw-turn").press("ArrowRight")
    tab.page.locator("button[title='undo: set object.1.face']").wait_for()
    tab.page.get_by_label("Search parameters").fill("face")
    tab.page.locator('[data-key="object.1.face"]').wait_for()  # the controls are of the chosen one
    save(tab)
    first, second = load_scene(page.scene).objects
    assert first.azimuth_deg == -60.0
    assert not {"position_m", "rotation_deg", "scale", "elevation_deg"} & second.model_fields_set
    assert (second.azimuth_deg, second.size_m) == (60.5, 1.2)
    assert second.distance_m == pytest.approx(2.0 * np.exp(-0.15), abs=2e-3)  # its middle moves as it swims
    assert second.face == pytest.approx(39.0, abs=0.1)
    page.scene.write_text(text, "utf-8")
    tab.page.locator(".uw-mark.uw-object").nth(1).wait_for(state="detached")


def test_a_frame_is_rendered_beside_the_scene_and_replaces_nothing(page: Page) -> None:
    tab = page.first
    there, made = (page.scene.parent / f"scene.frame-0000{ending}.png" for ending in ("", "-2"))
    there.write_text("of another", "utf-8")
    tab.page.get_by_role("button", name="Render frame").click()
    tab.page.get_by_role("link", name=f"Open {made.name}").wait_for()
    tab.page.keyboard.press("Escape")
    tab.page.get_by_role("form", name="Render").wait_for(state="hidden")
    assert made.stat().st_size > 10000
    assert there.read_text("utf-8") == "of another"


def test_nothing_was_asked_of_other_machines(page: Page) -> None:
    time.sleep(0.2)  # for requests that are on their way
    asked = [url for tab in page.tabs for url in tab.asked]
    assert len(asked) > 20
    own = (page.base, page.base.replace("http", "ws"), "data:", f"blob:{page.base}")
    assert [url for url in asked if not url.startswith(own)] == []
    assert [wrong for tab in page.tabs for wrong in tab.wrong] == []
