"""In Chromium: a character walks while W is held, goes where the ground is clicked, and follows prompts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from motiongen_client import Motion
from motiongen_client.blocking import MotionClient
from motiongen_tools.server_process import ServerProcess
from tests.system.view.chromium import Page

pytestmark = pytest.mark.system


def test_w_held_for_three_seconds_walks_ahead(page: Page, pictures: Path) -> None:
    x, z = page.root()
    forward = page.run(
        "const d = motiongen.stage.camera.getWorldDirection(motiongen.stage.camera.position.clone()); return [d.x, d.z]"
    )
    page.run("document.getElementById('stage').focus()")
    page.keys.key_down("w").perform()
    start = page.until(
        "motiongen.cast.one.info.edits.find(({ op, state }) => op === 'set_velocity' && state === 'accepted')"
    )
    page.until("motiongen.cast.one.track.playhead() >= arguments[0] + 60", start["effective_frame"])  # three seconds
    page.keys.key_up("w").perform()
    here = page.root()
    assert (here[0] - x) * forward[0] + (here[1] - z) * forward[1] > 1.5
    page.until("motiongen.cast.one.info.latency_ms !== null")
    page.picture(pictures / "held-w.png")
    assert page.complaints() == []


@pytest.mark.parametrize("meanwhile", ["/", Keys.CONTROL, "click"], ids=["slash", "control", "click"])
def test_released_key_stops_steering_whatever_has_the_focus_by_then(page: Page, meanwhile: str) -> None:
    page.run(
        """
        const { cast } = motiongen, tell = cast.tell.bind(cast);
        globalThis.said = [];
        cast.tell = (message) => (said.push(message), tell(message));
        document.getElementById("stage").focus();
        """
    )
    page.keys.key_down("w").perform()
    page.until("said.some(({ x_mps, z_mps }) => Math.hypot(x_mps, z_mps) > 1)")
    if meanwhile == "click":
        page.driver.find_element(By.ID, "prompt-text").click()
    else:
        page.keys.key_down(meanwhile).perform()
    page.keys.key_up("w").perform()
    page.until("motiongen.velocity._last === null")
    count = page.run("return said.length")
    assert page.run("return said.at(-1)").items() >= {"op": "set_velocity", "x_mps": 0, "z_mps": 0}.items()
    if meanwhile != "click":
        page.keys.key_up(meanwhile).perform()
    at = page.run("return motiongen.cast.one.track.playhead()")
    page.until(
        "motiongen.cast.one.track.playhead() > arguments[0] + 20", at
    )  # a second, in which a held key would be sent again
    assert page.run("return said.length") == count


def test_gamepad_speed_follows_its_tilt(page: Page) -> None:
    page.run(
        "globalThis.pad = { axes: [0, 0], buttons: [{ pressed: false }] }; navigator.getGamepads = () => [null, pad]"
    )
    page.run("document.getElementById('keep-prompt').click()")
    page.run("pad.axes = [0, -0.5]")
    slow = page.until("motiongen.velocity._last")
    assert math.hypot(slow["x"], slow["z"]) == pytest.approx(0.6, abs=1e-6)
    page.run("pad.axes = [0, -1]; pad.buttons[0].pressed = true")
    page.until("Math.hypot(motiongen.velocity._last.x, motiongen.velocity._last.z) > 2.9")
    page.run("pad.axes = [0.1, 0.05]")  # as sticks report at rest
    page.until("motiongen.velocity._last === null")
    assert page.complaints() == []


def test_with_alt_the_character_faces_where_the_camera_looks(page: Page) -> None:
    ahead = page.run(
        "const d = motiongen.stage.camera.getWorldDirection(motiongen.stage.camera.position.clone()); return [d.x, d.z]"
    )
    page.run("document.getElementById('stage').focus()")
    page.keys.key_down("s").perform()
    assert page.until("motiongen.velocity._last")["heading"] is None
    page.keys.key_up("s").perform()
    page.until("motiongen.velocity._last === null")
    page.keys.key_down(Keys.ALT).key_down("s").perform()
    back = page.until("motiongen.velocity._last")
    assert back["heading"] == pytest.approx(math.atan2(*ahead), abs=0.05)
    assert back["x"] * ahead[0] + back["z"] * ahead[1] < -0.5
    page.keys.key_up("s").key_up(Keys.ALT).perform()
    page.until("motiongen.velocity._last === null")
    assert page.complaints() == []


def test_clicked_place_is_reached_within_the_residual_shown(page: Page) -> None:
    spot = page.run(
        """
        const { stage, cast } = motiongen;
        const root = cast.one.rig.position(0);
        return stage.onScreen(root.clone().set(root.x + 1.2, 0, root.z + 1.0));
        """
    )
    canvas = page.driver.find_element(By.ID, "stage")
    box = canvas.rect
    page.keys.move_to_element_with_offset(
        canvas, round(spot[0] - box["width"] / 2), round(spot[1] - box["height"] / 2)
    ).click().perform()
    target = page.until("motiongen.cast.one.info.targets.find(({ state }) => state === 'met' || state === 'missed')")
    assert target["state"] == "met"
    page.until("motiongen.cast.one.track.playhead() >= arguments[0]", target["last"])
    walked = page.run("const { rig, track } = motiongen.cast.one; return track.rows.map((row) => rig.rootOf(row))")
    away = min(math.hypot(x - target["spec"]["x_m"], z - target["spec"]["z_m"]) for x, z in walked)
    assert away <= target["position_error_m"] + 1e-3
    assert page.complaints() == []


def test_typed_prompts_and_presets_take_effect(page: Page) -> None:
    box = page.driver.find_element(By.ID, "prompt-text")
    box.send_keys("a person walks forward\n")
    page.until("motiongen.cast.one.info.spans.at(-1)?.text === 'a person walks forward'")
    edit = page.until("motiongen.cast.one.info.edits.find(({ latency_ms }) => latency_ms !== null)")
    assert edit["effective_frame"] > edit["at_frame"]
    page.driver.find_element(By.CSS_SELECTOR, "[data-preset=wave-both]").click()
    page.until("motiongen.cast.one.info.spans.at(-1)?.preset === 'wave-both'")
    assert page.run("return motiongen.cast.one.info.spans.at(-2).end") is not None


def test_page_computes_the_same_pose_as_the_client(page: Page, motion_server: ServerProcess) -> None:
    with MotionClient(motion_server.address) as client:
        (rig,) = client.catalog.rigs[:1]
    row, shown = page.run(
        """
        const { rig, track } = motiongen.cast.one;
        rig.pose(track.row(5));
        return [Array.from(track.row(5)), Array.from(rig.positions)];
        """
    )
    expected = Motion(rig, 5, np.array([row], np.float32)).joint_positions_m()[0]
    np.testing.assert_allclose(np.reshape(shown, (-1, 3)), expected, atol=1e-4)


def test_twenty_characters_are_shown_and_removed(page: Page) -> None:
    count = page.driver.find_element(By.ID, "add-count")
    count.clear()
    count.send_keys("19")
    page.driver.find_element(By.ID, "add").click()
    page.until("motiongen.cast.members.size === 20")
    page.until("[...motiongen.cast.members.values()].every(({ track }) => track.playhead() > 1)")
    page.until("motiongen.bodies.mesh.count === 20 * motiongen.cast.one.rig.bones.length")
    page.run("motiongen.cast.ask({ op: 'remove', character: 7 })")
    page.until("motiongen.cast.members.size === 19")
    assert page.complaints() == []


def test_marks_of_finished_targets_leave_nothing_on_the_gpu(page: Page) -> None:
    held = []
    for count in (1, 2):
        place = {"kind": "waypoint", "frame": 0, "at_any_frame": True, "x_m": 0.3 * count, "z_m": 0.3}
        page.tell(op="add_constraints", constraints=[place])
        page.until("motiongen.cast.one.info.targets.length === arguments[0]", count)
        target = page.until(
            "motiongen.cast.one.info.targets.at(-1).state.startsWith('m') && motiongen.cast.one.info.targets.at(-1)"
        )
        page.until("motiongen.cast.one.track.playhead() > arguments[0] + 3.2 * 20", target["last"])
        page.until_drawn()
        held.append(page.run("return motiongen.stage.renderer.info.memory.geometries"))
    assert held[0] == held[1]
