"""In Chromium: errors around a page are reported in words, and the page goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from selenium.webdriver.common.by import By

from tests.system.view.chromium import Page

pytestmark = pytest.mark.system

NOTED = "[...document.querySelectorAll('#notes p')].some(({ textContent }) => textContent.includes(arguments[0]))"
STORED = "motiongen-prompts"


@pytest.fixture
def own_storage(page: Page) -> Iterator[Page]:
    yield page
    page.run("localStorage.removeItem(arguments[0])", STORED)


@pytest.mark.parametrize("held", ["{", '{"a": 1}', "3"])
def test_invalid_stored_prompts_do_not_break_the_page(own_storage: Page, held: str) -> None:
    page = own_storage
    page.run("localStorage.setItem(arguments[0], arguments[1])", STORED, held)
    page.driver.refresh()
    page.until_shown()
    page.driver.find_element(By.ID, "prompt-text").send_keys("a person walks forward\n")
    page.until("""localStorage.getItem(arguments[0]) === '["a person walks forward"]'""", STORED)
    assert page.complaints() == []


def test_page_works_without_local_storage(view: str, open_page: Callable[..., Page]) -> None:
    page = open_page(view)
    none = "Object.defineProperty(window, 'localStorage', { get() { throw new DOMException('not here'); } })"
    page.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": none})
    page.driver.refresh()
    page.until_shown()
    page.driver.find_element(By.ID, "prompt-text").send_keys("a person walks forward\n")
    page.until("document.getElementById('prompt-said').options.length === 1")
    assert page.complaints() == []


def test_browser_without_webgl_is_reported(view: str, open_page: Callable[..., Page]) -> None:
    page = open_page(view, "--disable-3d-apis")
    page.until("document.getElementById('status').textContent.includes('WebGL')")


def test_reason_for_a_missing_server_is_shown(page: Page) -> None:
    tell = """
        const [state, detail] = arguments, told = { type: "server", role: "control", address: "host:1", state, detail };
        motiongen.connection.dispatchEvent(new CustomEvent("message", { detail: told }));
    """
    shown = "document.getElementById('status-server').value === arguments[0]"
    page.run(tell, "connecting", "")
    page.until(shown, "waiting for host:1")
    page.run(tell, "connecting", "no motiongen server answers at host:1: it has TLS")
    page.until(shown, "no motiongen server answers at host:1: it has TLS")
    page.run(tell, "connected", "")


def test_error_of_the_page_is_reported_once(page: Page) -> None:
    for _ in range(3):  # as browsers report uncaught errors
        page.run("dispatchEvent(new ErrorEvent('error', { error: new Error('out of cheese') }))")
    page.run("dispatchEvent(new ErrorEvent('error', { message: 'a ResizeObserver was late' }))")
    notes = page.run("return [...document.querySelectorAll('#notes p.error')].map(({ textContent }) => textContent)")
    assert len(notes) == 1
    assert notes[0].startswith("an error occurred in the page: out of cheese.")


def test_silent_connection_is_replaced_by_another(view: str, open_page: Callable[..., Page]) -> None:
    page = open_page(view)
    page.until_shown()
    page.run(
        """
        const { connection } = motiongen, now = performance.now.bind(performance);
        globalThis.first = connection._socket;
        first.onmessage = first.onclose = null; // the network has gone: nothing comes, not even an end
        connection._askedMs = null;
        connection._ping();
        performance.now = () => now() + 15_000;
        connection._ping();
        globalThis.waited = connection._socket === first && connection.isOpen;
        globalThis.asked = connection.ask({ op: "pause" }).catch((error) => error.message);
        performance.now = () => now() + 25_000;
        connection._ping();
        """
    )
    assert page.run("return waited"), "a slow connection is not a lost one"
    assert page.run("return asked") == "the connection to the bridge was lost"
    page.until("motiongen.connection._socket !== first && motiongen.connection.isOpen")
    page.until("motiongen.connection.roundTripMs !== null")
    assert page.complaints() == []


@pytest.mark.parametrize(
    ("fetch", "said"),
    [
        ("async () => new Response('Internal Server Error', { status: 500 })", "Internal Server Error"),
        ("async () => new Response('', { status: 502 })", "the bridge answers 502"),
        ("async () => { throw new TypeError('Failed to fetch'); }", "the bridge does not answer"),
    ],
)
def test_failed_download_of_a_take_is_reported_in_words(page: Page, fetch: str, said: str) -> None:
    page.run(f"globalThis.realFetch ??= fetch; globalThis.fetch = {fetch}")
    page.driver.find_element(By.CSS_SELECTOR, '[data-take="npz"]').click()
    page.until(NOTED, said)
    assert page.complaints() == []


@pytest.mark.parametrize("act", ["_load(file)", "_open({ files: [file] })"])
def test_unreadable_file_is_named(page: Page, act: str) -> None:
    name = "walk.json" if act.startswith("_load") else "walk.glb"
    said = page.run(
        f"""
        const file = new File(["{{"], "{name}"), {{ takes }} = motiongen;
        Object.defineProperty(takes, "_file", {{ value: {{ files: [file], value: "" }} }});
        return takes.{act}.then(() => "taken", (error) => error.message);
        """
    )
    assert said.startswith(f"{name} ")
    assert "JSON" in said or "glTF" in said


def test_frame_without_finite_numbers_leaves_the_camera_alone(page: Page) -> None:
    page.pause()
    page.run("for (const row of motiongen.cast.one.track.rows) row.fill(NaN)")
    page.until_drawn()
    page.press("v")
    page.until_drawn()
    where = "[...motiongen.stage.camera.position, ...motiongen.stage.controls.target].every(Number.isFinite)"
    assert page.run(f"return {where}")


def test_frames_are_accepted_beside_those_of_an_unknown_character(page: Page) -> None:
    page.pause()
    told = page.run(
        """
        const { cast, connection } = motiongen, { one } = cast, width = one.rig.rowWidth;
        const rows = new Float32Array(7 + width).fill(5), first = one.track.end;
        const heads = [[99, 0, 0, 0, 1, 0, 1], [one.number, one.track.playhead(), 0, 0, first + 1, first, 1]];
        const header = { type: "frames", heads, widths: [7, width] };
        connection.dispatchEvent(new CustomEvent("binary", { detail: { header, rows } }));
        return [one.track.end - first, one.track.row(first)[0]];
        """
    )
    assert told == [1, 5]


def test_character_whose_rig_is_no_longer_offered_is_shown(page: Page) -> None:
    shown = page.run(
        """
        const { cast, connection } = motiongen, { rig, info } = cast.one;
        const described = {
          id: "gone", joints: rig.joints, parents: rig.parents, offsets_m: rig.offsets.map((each) => each.toArray()),
          frame_rate_hz: 20, row_width: rig.rowWidth, columns: rig.columns, limbs: rig.limbs, hip_joints: null,
        };
        const detail = { ...info, type: "character", number: 99, name: "of old", seed: "1", rig: "gone", described };
        connection.dispatchEvent(new CustomEvent("message", { detail }));
        const names = [...document.querySelectorAll("#people .who")].map(({ textContent }) => textContent);
        const { id } = cast.members.get(99).rig;
        cast._keep(new Set([info.number]));
        return [id, names.at(-1)];
        """
    )
    assert shown == ["gone", "of old"]


def test_take_without_frames_can_be_compared(page: Page) -> None:
    page.run(
        """
        const { cast, compare } = motiongen, { info, number } = cast.one;
        cast._note({ ...info, number: 99, seed: "1" });
        cast.choose(number);
        document.getElementById("compare-with").value = "c99";
        compare.toggle();
        """
    )
    assert page.run("return motiongen.compare.pair?.length") == 2
    for _ in range(3):
        drawn = page.run("return motiongen.stage.renderer.info.render.frame")
        page.until("motiongen.stage.renderer.info.render.frame > arguments[0]", drawn)
    page.run("motiongen.compare.toggle(); motiongen.cast._keep(new Set([motiongen.cast.chosen]))")
    assert page.complaints() == []
