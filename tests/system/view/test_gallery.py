"""In Chromium: a gallery opened from a file plays all takes, also side by side."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By

from motiongen_tools.cli import run
from motiongen_tools.server_process import ServerProcess
from tests.system.view.chromium import Page

pytestmark = [pytest.mark.system, pytest.mark.timeout(400)]


def test_gallery_opened_from_a_file_plays_all_takes(
    motion_server: ServerProcess, open_driver: Callable[..., webdriver.Chrome], tmp_path: Path, pictures: Path
) -> None:
    path = tmp_path / "gallery.html"
    arguments = ["gallery", "motiongen-mini", "--server", motion_server.address, "--steps", "2,4"]
    assert run([*arguments, "--out", str(path)]) == 0
    page = Page(open_driver(size=(1300, 1000)), path.as_uri())
    page.until("globalThis.gallery?.pictures.some(({ isSeen }) => isSeen)")
    assert page.run("return document.querySelectorAll('.row').length") == 30
    page.until("gallery.state.seconds > 0.2")  # it plays by itself
    page.driver.find_element(By.ID, "play").click()
    stopped = page.run("gallery.state.seconds = 2; return gallery.state.seconds")
    page.until_drawn()
    assert page.run("return gallery.state.seconds") == stopped
    page.picture(pictures / "gallery.png")
    turn = page.run("return gallery.state.turn")
    canvas = page.driver.find_element(By.CSS_SELECTOR, "canvas")
    page.keys.drag_and_drop_by_offset(canvas, 60, 0).perform()
    assert page.run("return gallery.state.turn") != turn
    page.driver.find_element(By.ID, "together").click()
    page.run("document.getElementById('part-1').scrollIntoView()")
    page.until_drawn()
    shown = "[...document.querySelectorAll('figure.both')].filter((each) => each.checkVisibility()).length"
    assert page.run(f"return {shown}") == 30
    page.picture(pictures / "gallery-side-by-side.png")
    page.driver.find_element(By.ID, "missed").click()
    bad = page.run("return document.querySelectorAll('.row.missed, .row.refused').length")
    left = page.run("return [...document.querySelectorAll('.row')].filter((row) => row.checkVisibility()).length")
    assert left == bad
    assert page.complaints() == []
