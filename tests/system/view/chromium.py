"""Headless Chromium with the viewer's page, for tests, pictures of the docs and measurements."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from selenium import webdriver
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.actions.action_builder import ActionBuilder
from selenium.webdriver.support.ui import WebDriverWait

from motiongen_client.errors import MotiongenError

PATIENCE_S = 150.0
PICTURE_TRIES = 6
SWITCHES = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)  # fmt: skip


class Page:
    """The page in Chromium. The page's own module `motiongen` says where things are."""

    def __init__(self, driver: webdriver.Chrome, address: str) -> None:
        self.driver = driver
        self.address = address
        driver.get(address)

    def run(self, script: str, *arguments: Any) -> Any:
        """The value of a piece of JavaScript."""
        return self.driver.execute_script(script, *arguments)

    def until(self, condition: str, *arguments: Any) -> Any:
        """Wait until an expression is true; returns it."""
        return WebDriverWait(self.driver, PATIENCE_S, 0.1).until(
            lambda driver: driver.execute_script(f"return {condition}", *arguments), f"never came: {condition}"
        )

    def until_shown(self) -> None:
        """Wait until the first character plays."""
        self.until("globalThis.motiongen?.cast.one && motiongen.cast.one.track.playhead() > 1")

    def until_drawn(self) -> None:
        """Wait until all changes are on the screen."""
        self.driver.execute_async_script(
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(done))"
        )

    def ground(self, x: float, z: float) -> tuple[int, int]:
        """The position in the window of a place in the world, in metres."""
        return self.at("const { x, z } = arguments[0]; return { x, y: 0, z }", {"x": x, "z": z})

    def at(self, script: str, *arguments: Any) -> tuple[int, int]:
        """The position in the window of a point {x, y, z} that a piece of JavaScript returns."""
        point = self.run(script, *arguments)
        place = """
            const { stage } = motiongen;
            stage.controls.enableDamping = false;
            const { x, y, z } = arguments[0], box = stage.canvas.getBoundingClientRect();
            const [right, down] = stage.onScreen(stage.camera.position.clone().set(x, y, z));
            return [Math.round(box.left + right), Math.round(box.top + down)];
        """
        x, y = self.run(place, point)
        return x, y

    def drag(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        """Drag with the left button from one point of the window to another, through the midpoint."""
        actions = ActionBuilder(self.driver, duration=50)
        pointer = actions.pointer_action
        pointer.move_to_location(*start).pointer_down()
        pointer.move_to_location((start[0] + end[0]) // 2, (start[1] + end[1]) // 2).move_to_location(*end)
        pointer.pointer_up()
        actions.perform()

    def press(self, *keys: str) -> None:
        """Press keys, one after another, on the element that has the focus."""
        self.keys.send_keys(*keys).perform()

    def tell(self, **message: Any) -> None:
        """Send a message of the page for the chosen character."""
        self.run("motiongen.cast.tell(arguments[0])", message)

    def tool(self, name: str) -> None:
        """Choose a tool, with the camera at rest and the character paused, so that nothing moves while it is used."""
        self.run("document.getElementById(arguments[0]).click()", f"tool-{name}")
        self.until_drawn()

    def pause(self) -> None:
        """Stop the playhead."""
        self.run("document.getElementById('pause').click()")
        self.until("motiongen.cast.one.info.is_paused")

    def go_on(self) -> None:
        """Continue after `pause`."""
        self.run("document.getElementById('pause').click()")
        self.until("!motiongen.cast.one.info.is_paused")

    def settled_target(self, kind: str) -> dict[str, Any]:
        """The last target of a kind, once it is met or missed."""
        script = """motiongen.cast.one.info.targets.findLast(
            ({ spec, state }) => spec.kind === arguments[0] && (state === 'met' || state === 'missed'))"""
        target: dict[str, Any] = self.until(script, kind)
        return target

    def root(self) -> tuple[float, float]:
        """The chosen character's place now, x and z in metres."""
        x, z = self.run("const m = motiongen.cast.one; return m.rig.rootOf(m.track.sample(m.track.playhead()))")
        return x, z

    @property
    def keys(self) -> ActionChains:
        return ActionChains(self.driver)

    def picture(self, path: Path) -> None:
        """Save a screenshot. A browser with software rendering on a busy machine may need more than one try."""
        for left in reversed(range(PICTURE_TRIES)):
            try:
                self.driver.save_screenshot(str(path))
                return
            except TimeoutException:
                if not left:
                    raise

    def complaints(self) -> list[str]:
        """The messages on the console, without those caused by software rendering."""
        said = [entry for entry in self.driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
        ours = [entry["message"] for entry in said if "GPU stall" not in entry["message"]]
        return [message for message in ours if "GL Driver Message" not in message]


def plain(address: str) -> str:
    """A page's address, with the cheapest rendering."""
    page, mark, token = address.partition("#")
    if "draw=plain" in page:
        return address
    return f"{page}{'&' if '?' in page else '?'}draw=plain{mark}{token}"


class BrowserMissing(MotiongenError):
    """Chromium or its driver is not installed."""

    def __init__(self) -> None:
        super().__init__("Chromium is not installed: make browser-packages")


def start_chromium(*switches: str, size: tuple[int, int] = (1100, 760)) -> webdriver.Chrome:
    """A new browser, to be ended with `quit`. size: of its window. Raises BrowserMissing."""
    chromium, chromedriver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or chromedriver is None:
        raise BrowserMissing
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for switch in (*SWITCHES, f"--window-size={size[0]},{size[1]}", *switches):
        options.add_argument(switch)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(chromedriver))
    driver.set_script_timeout(PATIENCE_S)
    return driver


class ViewerFailed(MotiongenError):
    """`motiongen view` did not start; the message has its output."""


@contextlib.contextmanager
def viewer(server: str, port: int = 0, *more: str) -> Iterator[list[str]]:
    """A bridge to a server. Yields the addresses that it prints: for steering and, if it has tokens, for watching."""
    with viewer_process(server, port, *more) as (addresses, _):
        yield addresses


@contextlib.contextmanager
def viewer_process(server: str, port: int = 0, *more: str) -> Iterator[tuple[list[str], int]]:
    """Like `viewer`, with the process id of the bridge. Raises ViewerFailed."""
    command = [sys.executable, "-m", "motiongen_tools", "view", "--server", server, "--port", str(port), *more]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stderr is not None
            line = process.stdout.readline()
            if not line:
                raise ViewerFailed(f"the viewer did not start: {process.stderr.read()}")
            addresses = [line.split()[-1]]
            while "Ctrl+C" not in (line := process.stdout.readline()):
                addresses.append(line.split()[-1])
            yield addresses, process.pid
        finally:
            process.terminate()
