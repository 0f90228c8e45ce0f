# SPDX-License-Identifier: Apache-2.0
"""The viewer and the time line in a browser: what is on the screen, where clicks land, what reaches Python."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from mr360uw.preview.screen import perspective
from mr360uw.tune import placing
from mr360uw.tune.placing import Point
from tests.tune.browser import chromium, served, started

COUNT, RATE = 300, 30.0
"""Of the page's clip."""
VIEWPORT = {"width": 760, "height": 640}
CODES = 3.0
"""Green and blue rise by 255 codes over the picture, which is drawn half a texel and half a code off at most on either
side; the place clicked is rounded to the screen's pixel, which is up to 1.3 codes."""


class Page:
    """The page under test. told: the events that reached Python since the last `forget`."""

    def __init__(self, page: Any, address: str) -> None:
        self.page, self.address = page, address
        self.messages: list[str] = []
        self.requests: list[str] = []
        page.on("console", lambda m: self.messages.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: self.messages.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def told(self, name: str) -> list[Any]:
        with urllib.request.urlopen(f"{self.address}/told") as answer:
            return [told for one, told in json.load(answer)[self.begin :] if one == name]

    def forget(self) -> None:
        with urllib.request.urlopen(f"{self.address}/told") as answer:
            self.begin = len(json.load(answer))

    def until(self, name: str, good: Callable[[Any], bool] = lambda _: True) -> Any:
        """Return the last event of a name, once it is as wanted."""
        for _ in range(1500):
            told = self.told(name)
            if told and good(told[-1]):
                return told[-1]
            self.page.wait_for_timeout(20)
        raise AssertionError(f"no {name} as wanted (got {self.told(name)[-1:]})")

    def settled(self) -> Any:
        """Return the view, once it has come to rest: longer ago than two events of it are apart."""
        while True:
            before = self.told("view")
            self.page.wait_for_timeout(200)
            if before and self.told("view") == before:
                return before[-1][0]

    def do(self, element: str, method: str, **arguments: Any) -> None:
        data = json.dumps(arguments).encode()
        urllib.request.urlopen(urllib.request.Request(f"{self.address}/do/{element}/{method}", data)).close()

    def fresh(self, *, look: bool = False, bare: bool = True) -> None:
        """Start with new elements. bare: without marks."""
        self.begin = 0
        self.page.mouse.move(0, 0)
        urllib.request.urlopen(urllib.request.Request(f"{self.address}/fresh", b"")).close()
        self.until("shown")
        self.page.wait_for_selector(".uw-mark")
        # What the timeline loads changes the room of the canvas: wait until it is at rest
        before = None
        while before != (before := self.canvas()):
            self.page.wait_for_timeout(200)
        if bare:
            self.do("viewer", "set_marks", markers=[])
            self.page.wait_for_selector(".uw-mark", state="detached")
        if look:
            self.page.click("text=Look around")

    def canvas(self) -> dict[str, float]:
        return self.page.locator(".uw-viewer canvas").bounding_box()

    def pixel(self, x: float, y: float) -> np.ndarray:
        """Return the colour (3,) uint8 RGB of the screen at a place."""
        self.page.evaluate("() => new Promise(requestAnimationFrame)")
        clip = {"x": int(x), "y": int(y), "width": 1, "height": 1}
        png = np.frombuffer(self.page.screenshot(clip=clip), np.uint8)
        return cv2.imdecode(png, cv2.IMREAD_COLOR)[0, 0, ::-1]

    def shows(self, x: float, y: float, told: Any) -> None:
        """Wait until the canvas shows at a place what the picture has at (u, v), wherever the page has the canvas by
        then.
        """
        for _ in range(200):
            box = self.canvas()
            seen = self.pixel(box["x"] + x, box["y"] + y) / 255.0
            if np.allclose(seen[1:], [told["u"], told["v"]], rtol=0.0, atol=CODES / 255.0):
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(f"({x}, {y}) shows {seen}, not u {told['u']}, v {told['v']}")

    def red(self, x: float, y: float, wanted: int) -> None:
        """Wait until a pixel of the canvas, at fractions of it, has a red, exactly."""
        box = self.canvas()
        for _ in range(200):
            got = int(self.pixel(box["x"] + x * box["width"], box["y"] + y * box["height"])[0])
            if got == wanted:
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(f"red is {got}, not {wanted}")

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        mouse = self.page.mouse
        mouse.move(*start)
        mouse.down()
        mouse.move(0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1]))
        mouse.move(*end)
        mouse.up()

    def middle(self, selector: str) -> tuple[float, float]:
        box = self.page.locator(selector).bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.fixture(scope="module")
def shown() -> Iterator[Page]:
    chromium()
    with served("tests.tune.harness") as address, started() as browser:
        page = Page(browser.new_page(viewport=VIEWPORT), address)
        page.page.goto(address)
        page.page.wait_for_selector(".uw-mark")
        yield page
        assert page.messages == [m for m in page.messages if "404" in m or "context" in m.lower()]
        assert page.requests
        assert all(url.startswith((address, "data:", "blob:")) for url in page.requests)


def flat_place(box: dict[str, float], point: Point) -> tuple[float, float]:
    """Return where a point shows in a flat panorama that fits into a canvas whole."""
    width = min(box["width"], 2.0 * box["height"])
    x, y = placing.pixel_of_point(point, 2, 1)
    return (
        box["x"] + 0.5 * box["width"] + width * (x / 2 - 0.5),
        box["y"] + 0.5 * box["height"] + width * (y / 2 - 0.25),
    )


def test_clicks_on_the_flat_picture_land_within_a_pixel(shown: Page) -> None:
    shown.fresh()
    box = shown.canvas()
    for across, down in ((0.5, 0.5), (0.3, 0.8), (0.8, 0.15)):
        place = round(box["x"] + across * box["width"]), round(box["y"] + down * box["height"])
        shown.forget()
        shown.page.mouse.click(*place)
        (told,) = shown.until("pick")
        point = Point(told["longitude"], told["latitude"])
        np.testing.assert_allclose(flat_place(box, point), place, atol=1.0)
        shown.shows(place[0] - box["x"], place[1] - box["y"], told)
    # enlarged by the wheel about the pointer, it still shows the same there
    for _ in range(2):
        shown.page.mouse.wheel(0, -600)
    shown.until("view", lambda told: told[0]["zoom"] > 2.0)
    shown.forget()
    shown.page.keyboard.down("Shift")
    shown.page.mouse.click(*place)
    shown.page.keyboard.up("Shift")
    (again,) = shown.until("pick")
    assert (again["u"], again["v"]) == pytest.approx((told["u"], told["v"]), abs=1e-6)
    assert again["shift"]


def test_drags_draw_lines_while_something_is_drawn(shown: Page) -> None:
    shown.fresh()
    shown.do("viewer", "set_drawing", kind="inside")
    box, mouse = shown.canvas(), shown.page.mouse
    shown.page.wait_for_function("() => document.querySelector('.uw-viewer') !== null")
    start, end = ((box["x"] + a * box["width"], box["y"] + 0.5 * box["height"]) for a in (0.4, 0.6))
    shown.forget()
    mouse.move(*start)
    mouse.down()
    mouse.move(*end, steps=8)
    shown.page.locator("path.uw-drawn.uw-inside").wait_for(state="attached")
    mouse.up()
    shown.page.locator("path.uw-drawn").wait_for(state="detached")  # it is Python's to keep
    (told,) = shown.until("stroke")
    points = [Point(*one) for one in told["points"]]
    assert len(points) > 4
    for point, place in ((points[0], start), (points[-1], end)):
        np.testing.assert_allclose(flat_place(box, point), place, atol=1.0)
    assert not shown.told("pick")
    assert not shown.told("view")  # it stays
    shown.page.keyboard.down("Shift")
    shown.drag(start, end)
    shown.page.keyboard.up("Shift")
    assert shown.settled()["u"] != 0.5
    assert len(shown.told("stroke")) == 1
    shown.do("viewer", "set_drawing", kind="")
    shown.forget()
    shown.drag(end, start)
    shown.until("view")
    assert not shown.told("stroke")


def test_looking_around_turns_the_view_and_clicks_land_within_a_pixel(shown: Page) -> None:
    shown.fresh(look=True)
    box = shown.canvas()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    shown.drag(middle, (middle[0] - 200, middle[1] - 80))
    view = shown.settled()
    assert view["yaw_deg"] > 10.0
    assert view["pitch_deg"] < -3.0
    assert not shown.told("pick")  # a drag is no click
    shown.page.mouse.wheel(0, 300)
    shown.page.locator(".uw-viewer canvas").press("ArrowRight")
    before, view = view, shown.settled()
    assert view["yaw_deg"] == pytest.approx(before["yaw_deg"] + 5.0)
    assert view["fov_deg"] > 91.0
    box = shown.canvas()
    size = round(box["width"]), round(box["height"])
    look = perspective(view["yaw_deg"], view["pitch_deg"], view["fov_deg"], *size)
    for x, y in ((size[0] / 2, size[1] / 2), (70.5, 40.5), (size[0] - 60.5, size[1] - 30.5)):
        shown.forget()
        shown.page.mouse.click(box["x"] + x, box["y"] + y)
        (told,) = shown.until("pick")
        beside = np.linalg.norm(Point(told["longitude"], told["latitude"]).direction - look.directions(x, y))
        assert beside < look.pixel_rad  # a pixel in the middle, the widest
        shown.shows(x, y, told)
    # the view stays when the picture changes, and returns on 0
    shown.do("viewer", "show", url="/picture/90.png")
    shown.red(0.5, 0.5, 90)
    assert shown.told("view") == []
    shown.page.locator(".uw-viewer canvas").press("0")
    (view,) = shown.until("view")
    assert (view["yaw_deg"], view["pitch_deg"], view["fov_deg"], view["look"]) == (0, 0, 90, True)
    for key, fov in (("+", 20), ("-", 140)):
        for _ in range(14):
            shown.page.locator(".uw-viewer canvas").press(key)
        shown.until("view", lambda told, fov=fov: told[0]["fov_deg"] == fov)


def test_both_pictures_show_in_wipe_and_side_by_side(shown: Page) -> None:
    shown.fresh()
    shown.page.wait_for_selector("button:has-text('Wipe'):enabled")
    shown.page.click("text=Wipe")
    shown.red(0.4, 0.75, 200)
    shown.red(0.6, 0.75, 40)
    box = shown.canvas()
    shown.drag(shown.middle(".uw-divider"), (box["x"] + 0.8 * box["width"], box["y"] + 100))
    shown.red(0.6, 0.75, 200)
    shown.red(0.85, 0.75, 40)
    shown.page.locator(".uw-divider").press("Home")
    shown.red(0.2, 0.75, 40)
    shown.page.click("text=Side by side")
    shown.red(0.25, 0.5, 200)
    shown.red(0.75, 0.5, 40)
    # both panes are one view: the same place of either is the same point
    shown.forget()
    clicks = []
    for across in (0.15, 0.65):
        shown.page.mouse.click(box["x"] + across * box["width"], box["y"] + 0.5 * box["height"])
        clicks.append(shown.until("pick", lambda told: [told] != clicks)[0])
        shown.forget()
    assert clicks[0]["u"] == pytest.approx(clicks[1]["u"], abs=1e-6)
    shown.page.click("text=Snapshot")
    shown.do("viewer", "show", url="/picture/120.png")
    shown.red(0.25, 0.5, 120)
    shown.red(0.75, 0.5, 200)


def test_pictures_say_that_they_are_old_and_what_they_are(shown: Page) -> None:
    shown.fresh()
    badge = shown.page.locator(".uw-badge")
    assert badge.count() == 0
    shown.do("viewer", "expect")
    badge.wait_for()
    assert "older" in badge.inner_text()
    shown.do("viewer", "show", url="/picture/60.png", stale=True)
    shown.red(0.5, 0.6, 60)
    assert "older" in badge.inner_text()
    shown.do("viewer", "show", url="/picture/70.png", coarse=True)
    shown.red(0.5, 0.6, 70)
    assert "draft" in badge.inner_text()
    # one that takes long is not shown over one that was asked for later
    shown.do("viewer", "show", url="/slow/80.png")
    shown.page.wait_for_timeout(50)
    shown.do("viewer", "show", url="/picture/100.png")
    shown.red(0.5, 0.6, 100)
    assert badge.count() == 0
    shown.page.wait_for_timeout(500)
    shown.red(0.5, 0.6, 100)
    shown.do("viewer", "show", url="/no-such.png")
    shown.page.locator(".uw-wrong").wait_for()
    assert "404" in shown.until("failed")[0]
    shown.red(0.5, 0.6, 100)

    # one that is no panorama is flat
    shown.page.click("text=Look around")
    shown.do("viewer", "show", url="/plan.png", panorama=False, name="plan")
    shown.red(0.5, 0.5, 128)
    shown.red(0.02, 0.5, 22)  # beside it there is nothing
    assert shown.page.locator(".uw-mark").count() == 0
    box = shown.canvas()
    shown.forget()
    shown.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 0.25 * box["height"])
    (told,) = shown.until("pick")
    assert told.get("longitude") is None
    assert (told["u"], told["v"]) == pytest.approx((0.5, 0.25), abs=1.0 / box["height"])


def test_a_lost_context_is_made_again_and_the_canvas_follows_the_window(shown: Page) -> None:
    shown.fresh()
    extension = "document.querySelector('.uw-viewer canvas').getContext('webgl2').getExtension('WEBGL_lose_context')"
    shown.page.evaluate(f"window.lose = {extension}; window.lose.loseContext()")
    shown.page.locator(".uw-wrong").wait_for()
    shown.page.evaluate("window.lose.restoreContext()")
    shown.page.locator(".uw-wrong").wait_for(state="detached")
    shown.red(0.5, 0.75, 200)
    sizes = "c.width, c.clientWidth, c.height, c.clientHeight"
    screen = shown.page.context.new_cdp_session(shown.page)
    for ratio in (1, 2):
        size = {"width": 700, "height": 600, "deviceScaleFactor": ratio, "mobile": False}
        screen.send("Emulation.setDeviceMetricsOverride", size)
        shown.page.wait_for_function(f"document.querySelector('.uw-viewer canvas').width === {700 * ratio}")
        canvas = shown.page.evaluate(
            f"() => {{ const c = document.querySelector('.uw-viewer canvas'); return [{sizes}] }}"
        )
        assert canvas[1] == 700
        assert abs(canvas[2] - ratio * canvas[3]) <= 1  # its height in the window may be a fraction
        shown.red(0.5, 0.75, 200)
    # As it was for what follows: without an override, or when its session ends, the window has the room of its own bars
    screen.send("Emulation.setDeviceMetricsOverride", {**VIEWPORT, "deviceScaleFactor": 1, "mobile": False})


def test_handles_are_dragged_and_moved_by_keys_and_keep_off_a_small_object(shown: Page) -> None:
    shown.fresh(bare=False)
    box = shown.canvas()
    whale = Point(0.35, -0.1)
    place = flat_place(box, whale)
    shown.page.click("button[aria-label='Whale']")
    assert shown.until("select") == ["whale"]
    handles = [np.array(shown.middle(f".uw-{name}")) for name in ("move", "turn", "scale", "object")]
    radius = 0.25 * box["width"] / (2.0 * np.pi)
    assert min(np.linalg.norm(handle - place) for handle in handles) > radius + 10.0  # that of a handle
    shown.forget()
    x, y = handles[0]
    shown.drag((x, y), (x + 120, y + 60))
    (end,) = shown.until("drag", lambda told: told[0]["phase"] == "end")
    phases = [told[0]["phase"] for told in shown.told("drag")]
    assert phases[0] == "start"
    assert phases[-1] == "end"
    assert set(phases[1:-1]) == {"move"}
    assert (end["name"], end["handle"], Point(**end["start"])) == ("whale", "move", whale)
    np.testing.assert_allclose(
        flat_place(box, Point(end["longitude"], end["latitude"])), (place[0] + 120, place[1] + 60), atol=1.5
    )  # a handle is at a whole pixel, with a border
    for handle in ("turn", "scale"):
        shown.forget()
        shown.page.locator(f".uw-{handle}").press("ArrowRight")
        (end,) = shown.until("drag", lambda told: told[0]["phase"] == "end")
        start, last = Point(**end["start"]), Point(end["longitude"], end["latitude"])
        assert end["handle"] == handle
        if handle == "turn":
            assert placing.yaw_by_drag(90.0, whale, start, last) == pytest.approx(89.0, abs=0.05)  # on a sphere
        else:
            assert placing.scale_by_drag(1.0, whale, start, last) == pytest.approx(1.02, abs=1e-9)


def test_the_wheel_over_the_chosen_object_changes_its_distance(shown: Page) -> None:
    shown.fresh(bare=False)
    place = flat_place(shown.canvas(), Point(0.35, -0.1))
    shown.page.click("button[aria-label='Whale']")
    shown.page.locator(".uw-move").wait_for()
    shown.forget()
    shown.page.mouse.move(*place)
    for _ in range(2):
        shown.page.mouse.wheel(0, -200)
    (end,) = shown.until("drag", lambda told: told[0]["phase"] == "end")
    assert (end["name"], end["handle"]) == ("whale", "reach")
    assert end["farther"] == pytest.approx(np.exp(-0.6))  # nearer, as a picture that is enlarged
    assert shown.told("view") == []
    shown.page.click("text=Marks")
    shown.page.wait_for_selector(".uw-mark", state="detached")


# --- time line -------------------------------------------------------------------------------------------------------


def strip_x(shown: Page, frame: float) -> tuple[float, float]:
    box = shown.page.locator(".uw-strip").bounding_box()
    return box["x"] + box["width"] * frame / COUNT, box["y"] + box["height"] / 2


def test_the_play_head_is_dragged_and_moved_by_keys(shown: Page) -> None:
    shown.fresh()
    shown.drag(strip_x(shown, 50.5), strip_x(shown, 120.5))
    (told,) = shown.until("seek", lambda told: told[0]["how"] == "")
    assert told["frame"] == 120
    assert all(one[0]["how"] == "scrub" for one in shown.told("seek")[:-1])
    strip = shown.page.locator(".uw-strip")
    strip.press("Shift+ArrowRight")
    strip.press("ArrowLeft")
    shown.until("seek", lambda told: told[0]["frame"] == 129)
    strip.press("i")
    strip.press("End")
    shown.until("seek", lambda told: told[0]["frame"] == COUNT - 1)
    assert shown.until("range") == [129, COUNT]
    shown.page.locator("[aria-label='Out point']").press("Shift+ArrowLeft")
    shown.until("range", lambda told: told == [129, COUNT - 10])
    shown.do("timeline", "set_frame", frame=10)
    shown.page.wait_for_selector(".uw-strip[aria-valuenow='10']")
    shown.do("timeline", "set_played", frames=[*range(129, 135), 140])
    shown.page.locator(".uw-played").nth(1).wait_for(state="attached")
    shown.page.click("[aria-label='Play']")
    shown.until("seek", lambda told: told[0]["how"] == "play" and told[0]["frame"] == 135)
    played = [one[0]["frame"] for one in shown.told("seek") if one[0]["how"] == "play"]
    assert max(played) == 135  # which is not there yet: the head waits for it
    shown.do("timeline", "set_played", frames=list(range(129, 141)))
    shown.until("seek", lambda told: told[0]["how"] == "play" and told[0]["frame"] == 141)
    shown.page.click("[aria-label='Pause']")
    shown.until("play", lambda told: told == [False])
    assert shown.told("play") == [[True], [False]]
    shown.until("seek", lambda told: told[0]["how"] == "")


def test_an_answer_to_an_older_step_does_not_undo_a_newer_one(shown: Page) -> None:
    """Python answers each step after the next one is made."""
    shown.fresh()
    shown.do("timeline", "set_frame", frame=10)
    shown.page.wait_for_selector(".uw-strip[aria-valuenow='10']")
    name = "mounted_app.elements[Object.keys(mounted_app.elements).find(k => mounted_app.elements[k].props.at)].props"
    late = f"() => {{ const p = {name}; p.at = {{ frame: 99, serial: 1000, after: p.at.after }}; }}"
    shown.page.locator(".uw-strip").press("ArrowRight")
    shown.page.evaluate(late)
    shown.until("seek", lambda told: told[0]["frame"] == 11)
    assert shown.page.locator(".uw-strip").get_attribute("aria-valuenow") == "11"
    shown.do("timeline", "set_frame", frame=40)
    shown.page.wait_for_selector(".uw-strip[aria-valuenow='40']")


def test_keys_are_dragged_added_and_removed(shown: Page) -> None:
    shown.fresh()
    key = "circle[data-key='1']"
    place = shown.middle(key)
    right = strip_x(shown, 180)[0]
    shown.drag(place, (right, place[1]))
    (edit,) = shown.until("keys", lambda told: told[0]["done"])
    assert edit["keys"][1] == [6.0, pytest.approx(12.0, abs=0.3)]  # a pixel is a quarter of 1 m/s
    shown.page.wait_for_selector(".uw-line:not([stroke-dasharray])")  # Python has answered
    shown.page.locator(key).press("ArrowUp")
    (edit,) = shown.until("keys", lambda told: told[0]["keys"][1][1] > edit["keys"][1][1])
    shown.page.mouse.dblclick(strip_x(shown, 60)[0], place[1])
    (edit,) = shown.until("keys", lambda told: len(told[0]["keys"]) == 4)
    assert edit["keys"][1] == [2.0, pytest.approx(12.0, abs=0.5)]
    shown.page.locator(key).press("Delete")
    (edit,) = shown.until("keys", lambda told: len(told[0]["keys"]) == 3)
    assert [t for t, _ in edit["keys"]] == [1.0, 6.0, 8.0]
    shown.page.click("text=hold")
    (edit,) = shown.until("keys", lambda told: told[0]["interpolation"] == "hold")
    assert len(edit["keys"]) == 3
