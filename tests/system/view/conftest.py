"""The viewer as a user has it: a server with the built-in model, `motiongen view`, and Chromium on its page."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.support.ui import WebDriverWait

from motiongen_tools.server_process import ServerProcess

PATIENCE_S = 90.0
SWITCHES = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--window-size=1100,760",
)  # fmt: skip


class Page:
    """The page in Chromium. Its own module `motiongen` tells where things are."""

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
        """Wait for the first character, playing."""
        self.until("globalThis.motiongen?.cast.one && motiongen.cast.one.track.playhead() > 1")

    def until_drawn(self) -> None:
        """Wait until everything that was changed is on the screen."""
        self.driver.execute_async_script(
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(done))"
        )

    def root(self) -> tuple[float, float]:
        """Where the chosen character is now, x and z in metres."""
        x, z = self.run("const m = motiongen.cast.one; return m.rig.rootOf(m.track.sample(m.track.playhead()))")
        return x, z

    @property
    def keys(self) -> ActionChains:
        return ActionChains(self.driver)

    def picture(self, path: Path) -> None:
        self.driver.save_screenshot(str(path))

    def complaints(self) -> list[str]:
        """What the console says beside what drawing by software brings."""
        said = [entry for entry in self.driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
        ours = [entry["message"] for entry in said if "GPU stall" not in entry["message"]]
        return [message for message in ours if "GL Driver Message" not in message]


@pytest.fixture(scope="session")
def motion_server() -> Iterator[ServerProcess]:
    with ServerProcess(
        ["--devices", "cpu:1", "--profile-s", "0.5", "--admit-load", "1000", "--drain-wait-s", "0"]
    ) as one:
        yield one


@contextlib.contextmanager
def viewer(server: str, port: int = 0, *more: str) -> Iterator[list[str]]:
    """A bridge to a server; the addresses that it prints: to steer, and to look on where it has tokens."""
    command = [sys.executable, "-m", "motiongen_tools", "view", "--server", server, "--port", str(port), *more]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline()
        if not line:
            pytest.fail(f"the viewer did not start: {process.stderr.read()}")
        addresses = [line.split()[-1]]
        while "Ctrl+C" not in (line := process.stdout.readline()):
            addresses.append(line.split()[-1])
        yield addresses
        process.terminate()


@pytest.fixture
def view(motion_server: ServerProcess) -> Iterator[str]:
    """The address of a page on that server."""
    with viewer(motion_server.address) as (address,):
        yield address


@pytest.fixture
def open_page(view: str) -> Iterator[Callable[..., Page]]:
    """Opens pages in browsers of their own, and ends them."""
    drivers: list[webdriver.Chrome] = []

    def open_one(address: str = view) -> Page:
        chromium, chromedriver = shutil.which("chromium"), shutil.which("chromedriver")
        if chromium is None or chromedriver is None:
            pytest.fail("Chromium is not installed: make browser-packages")
        options = webdriver.ChromeOptions()
        options.binary_location = chromium
        for switch in SWITCHES:
            options.add_argument(switch)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        drivers.append(webdriver.Chrome(options=options, service=Service(chromedriver)))
        drivers[-1].set_script_timeout(PATIENCE_S)
        return Page(drivers[-1], address)

    yield open_one
    for driver in drivers:
        driver.quit()


@pytest.fixture
def page(open_page: Callable[..., Page]) -> Page:
    opened = open_page()
    opened.until_shown()
    return opened
