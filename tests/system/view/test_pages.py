"""In Chromium: several pages show one character, spectators cannot steer, and a page outlives its bridge."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import urlsplit

import pytest
from selenium.webdriver.common.by import By

from motiongen_tools.server_process import ServerProcess
from tests.system.view.chromium import Page, viewer

pytestmark = pytest.mark.system


def test_two_pages_show_and_steer_one_character(page: Page, open_page: Callable[..., Page]) -> None:
    other = open_page(page.address)
    other.until_shown()
    assert other.run("return motiongen.cast.members.size") == 1
    page.driver.find_element(By.CSS_SELECTOR, "[data-preset=walk]").click()
    other.until("motiongen.cast.one.info.spans.at(-1)?.preset === 'walk'")


def test_spectators_watch_and_cannot_steer(motion_server: ServerProcess, open_page: Callable[..., Page]) -> None:
    with viewer(motion_server.address, 0, "--token") as (to_steer, to_look_on):
        stranger = open_page(to_steer.partition("#")[0])
        stranger.until("document.getElementById('status-server').value.includes('token')")
        steering = open_page(to_steer)
        steering.until_shown()
        watching = open_page(to_look_on)
        watching.until_shown()
        assert watching.run("return motiongen.cast.role") == "watch"
        assert not watching.driver.find_element(By.ID, "prompt").is_displayed()
        refused = watching.run(
            "return motiongen.cast.tell({ op: 'pause' }).then(() => 'taken', (error) => error.message)"
        )
        assert "spectators" in refused


def test_invalid_room_is_reported_and_not_requested_again(view: str, open_page: Callable[..., Page]) -> None:
    page = open_page(f"{view}?room=a%20b")
    page.until("document.getElementById('status-server').value.includes('1 to 40 letters')")
    page.run("globalThis.first = motiongen.connection._socket")
    # timers fire in order: a reconnect would have happened by then
    page.driver.execute_async_script("setTimeout(arguments[0], 1000)")
    assert page.run("return motiongen.connection._socket === first && !motiongen.connection.isOpen")
    refused = page.run("return motiongen.cast.ask({ op: 'add' }).then(() => 'taken', (error) => error.message)")
    assert "1 to 40 letters" in refused


def test_page_shows_what_another_server_offers(page: Page) -> None:
    told = page.run("return { models: motiongen.cast.models, limits: motiongen.cast.limits }")
    model = {**told["models"][0], "id": "other", "presets": [{"id": "hop", "text": "a person hops", "expect": ""}]}
    offer = """
        const detail = { type: "catalog", rigs: [], ...arguments[0] };
        motiongen.connection.dispatchEvent(new CustomEvent("message", { detail }));
        const values = (id) => [...document.getElementById(id).options].map(({ value }) => value);
        return [values("add-model"), document.getElementById("add-model").value, values("again-model")];
    """
    mine = told["models"][0]["id"]
    both = page.run(offer, {**told, "models": [model, told["models"][0]]})
    assert both == [["other", mine], mine, ["other", mine]], "the chosen model stays chosen"
    other = page.run(offer, {**told, "models": [model]})
    assert other == [["other"], "other", ["other"]]
    page.driver.find_element(By.CSS_SELECTOR, "[data-preset=hop]")
    at = page.run("return motiongen.cast.one.track.playhead()")
    page.until("motiongen.cast.one.track.playhead() > arguments[0] + 5", at)  # the present character plays on
    assert page.complaints() == []


def test_page_continues_with_a_restarted_bridge(motion_server: ServerProcess, open_page: Callable[..., Page]) -> None:
    with viewer(motion_server.address) as (address,):
        page = open_page(address)
        page.until_shown()
    page.until("document.getElementById('status-server').value.includes('trying again')")
    with viewer(motion_server.address, urlsplit(address).port or 0) as (same,):
        assert same == address
        page.until("motiongen.connection.isOpen && motiongen.cast.members.size === 0")
        page.driver.find_element(By.ID, "add").click()
        page.until_shown()


def test_page_continues_with_a_restarted_server(open_page: Callable[..., Page]) -> None:
    settings = ["--devices", "cpu:1", "--profile-s", "0.5", "--admit-load", "1000", "--drain-wait-s", "0"]
    with ServerProcess([*settings, "--drain-grace-s", "0"]) as first:
        address = first.address
        with viewer(address) as (view,):
            page = open_page(view)
            page.until_shown()
            page.run("document.querySelector('[data-preset=walk]').click()")
            page.until("motiongen.cast.one.info.spans.at(-1)?.preset === 'walk'")
            first.stop()
            page.until("document.getElementById('status-server').value.includes('lost')")
            with ServerProcess([*settings, "--port", address.rpartition(":")[2]]) as second:
                assert second.address == address
                page.until("motiongen.cast.one.info.resumes + motiongen.cast.one.info.reopenings === 1")
                at = page.run("return motiongen.cast.one.track.playhead()")
                page.until("motiongen.cast.one.track.playhead() > arguments[0] + 30", at)
                assert page.run("return motiongen.cast.one.info.spans.at(-1).preset") == "walk"
