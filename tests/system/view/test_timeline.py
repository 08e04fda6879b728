"""In Chromium: prompt spans are moved, earlier frames are looked at, and takes are saved and opened."""

from __future__ import annotations

from pathlib import Path

import pytest
from selenium.webdriver.common.by import By

from motiongen_tools.npz import read_npz
from motiongen_tools.view.session_file import read_session
from tests.system.view.chromium import Page

pytestmark = pytest.mark.system

SPAN_X = """
    const { timeline, cast } = motiongen;
    const span = cast.one.info.spans.find(({ scheduled }) => scheduled);
    const canvas = document.getElementById("timeline-canvas");
    return [timeline._view.toX((span.start + span.end) / 2) - canvas.clientWidth / 2, timeline._view.pixelsPerFrame];
"""


def test_dragged_span_moves_later_and_undo_moves_it_back(page: Page) -> None:
    page.driver.find_element(By.ID, "pause").click()  # so that the span does not begin while it is dragged
    page.until("motiongen.cast.one.info.is_paused")
    page.run("motiongen.timeline._view.seconds = 25")
    page.until_drawn()
    page.run("document.getElementById('prompt-when').value = 6; document.getElementById('prompt-seconds').value = 3")
    page.driver.find_element(By.CSS_SELECTOR, "[data-preset=wave-both]").click()
    before = page.until("motiongen.cast.one.info.spans.find(({ scheduled }) => scheduled)")
    canvas = page.driver.find_element(By.ID, "timeline-canvas")
    x, pixels = page.run(SPAN_X)
    middle = canvas.size["height"] // 2
    drag = page.keys.move_to_element_with_offset(canvas, round(x), 46 - middle).click_and_hold()
    drag.move_by_offset(round(40 * pixels), 0).release().perform()
    after = page.until(
        "motiongen.cast.one.info.spans.find(({ scheduled, start }) => scheduled && start > arguments[0])",
        before["start"],
    )
    assert after["end"] - after["start"] == before["end"] - before["start"]
    page.driver.find_element(By.ID, "undo").click()
    page.until(
        "motiongen.cast.one.info.spans.some(({ scheduled, start }) => scheduled && start === arguments[0])",
        before["start"],
    )
    assert page.complaints() == []


def test_earlier_frame_is_shown_while_the_playhead_goes_on(page: Page) -> None:
    page.until("motiongen.cast.one.track.playhead() > 30")
    page.run("motiongen.timeline.lookAt(10)")
    page.until("document.getElementById('where').value.startsWith('looking at frame 10')")
    there = page.run("return motiongen.timeline.place(motiongen.cast.one)")
    live = page.run("return motiongen.cast.one.track.playhead()")
    assert there == 10
    page.until("motiongen.cast.one.track.playhead() > arguments[0]", live)
    page.driver.find_element(By.ID, "live").click()
    assert page.run("return motiongen.timeline.seek") is None
    page.driver.find_element(By.ID, "pause").click()
    page.until("motiongen.cast.one.info.is_paused")
    page.driver.find_element(By.ID, "pause").click()
    page.until("!motiongen.cast.one.info.is_paused")


def test_take_is_saved_and_opened_again(page: Page, tmp_path: Path) -> None:
    page.driver.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)})
    page.until("motiongen.cast.one.track.playhead() > 20")
    for name in ("npz", "bvh", "session.json"):
        page.driver.find_element(By.CSS_SELECTOR, f'[data-take="{name}"]').click()
        page.until(
            "[...document.querySelectorAll('#notes p')].some(({ textContent }) => textContent.includes(arguments[0]))",
            name,
        )
    page.driver.find_element(By.ID, "open-file").send_keys(str(_saved(tmp_path, "character-1.npz", page)))
    page.until("motiongen.takes.opened.length === 1")
    assert page.run("return motiongen.takes.opened[0].numFrames") == len(read_npz(tmp_path / "character-1.npz"))
    assert read_session(_saved(tmp_path, "character-1.session.json", page)).opening["preset"] == "stand"
    page.driver.find_element(By.ID, "open-file").send_keys(str(_saved(tmp_path, "character-1.bvh", page)))
    page.until("motiongen.takes.opened.length === 2")
    assert page.complaints() == []


def _saved(folder: Path, name: str, page: Page) -> Path:
    """Wait until the browser has written a file. Returns its path."""
    while not (folder / name).exists():
        page.run("return 0")
    return folder / name
