"""The viewer as users have it: a server with the built-in model, `motiongen view`, and Chromium with its page."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from selenium import webdriver

from motiongen_tools.server_process import ServerProcess
from tests.system.view.chromium import Page, plain, start_chromium, viewer

KEPT = Path(__file__).parents[3] / "out" / "view"


@pytest.fixture(scope="session")
def pictures() -> Path:
    """The folder in which screenshots are kept for inspection."""
    KEPT.mkdir(parents=True, exist_ok=True)
    return KEPT


@pytest.fixture(scope="session")
def motion_server() -> Iterator[ServerProcess]:
    with ServerProcess(
        ["--devices", "cpu:1", "--profile-s", "0.5", "--admit-load", "1000", "--drain-wait-s", "0"]
    ) as one:
        yield one


@pytest.fixture(scope="session")
def view(motion_server: ServerProcess) -> Iterator[str]:
    """The address of a page on that server."""
    with viewer(motion_server.address) as (address,):
        yield address


@pytest.fixture
def open_driver() -> Iterator[Callable[..., webdriver.Chrome]]:
    """Starts browsers, and ends them."""
    drivers: list[webdriver.Chrome] = []

    def start(*switches: str, size: tuple[int, int] = (1100, 760)) -> webdriver.Chrome:
        drivers.append(start_chromium(*switches, size=size))
        return drivers[-1]

    yield start
    for driver in drivers:
        driver.quit()


@pytest.fixture
def open_page(view: str, open_driver: Callable[..., webdriver.Chrome]) -> Callable[..., Page]:
    """Opens pages in new browsers, with the cheapest rendering, because there is no GPU."""

    def open_one(address: str = view, *switches: str, size: tuple[int, int] = (1000, 760)) -> Page:
        return Page(open_driver(*switches, size=size), plain(address))

    return open_one


@pytest.fixture(scope="session")
def driver() -> Iterator[webdriver.Chrome]:
    """A browser for all tests that do not change it."""
    one = start_chromium(size=(900, 700))
    yield one
    one.quit()


_rooms = itertools.count(1)


@pytest.fixture
def page(view: str, driver: webdriver.Chrome) -> Iterator[Page]:
    """A page with its own room, with the first character in it."""
    driver.get_log("browser")  # discard what earlier tests have logged
    opened = Page(driver, plain(f"{view}?room=room-{next(_rooms)}"))
    opened.until_shown()
    yield opened
    opened.run(
        "for (const number of motiongen.cast.members.keys()) motiongen.cast.ask({ op: 'remove', character: number })"
    )
    opened.until("motiongen.cast.members.size === 0")
