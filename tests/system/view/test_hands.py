"""In Chromium: keys, the focus and the pointer act as intended, whatever else happens meanwhile."""

from __future__ import annotations

import pytest
from selenium.webdriver.common.actions.action_builder import ActionBuilder
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from tests.system.view.chromium import Page

pytestmark = pytest.mark.system

LISTEN = """
    const { cast } = motiongen;
    globalThis.said = [];
    cast.tell = (message) => (said.push(message), new Promise((resolve) => (globalThis.answer = resolve)));
"""


def test_focus_stays_on_a_button_while_plans_arrive(page: Page) -> None:
    far = page.run("return Math.floor(motiongen.cast.one.track.playhead()) + 1200")
    page.tell(op="add_constraints", constraints=[{"kind": "heading", "frame": far, "heading_rad": 1}])
    page.until("document.querySelector('#targets .waiting button')")
    page.run("globalThis.drop = document.querySelector('#targets .waiting button'); drop.focus()")
    page.tell(op="set_prompt", text="a person walks forward")
    page.until("motiongen.cast.one.info.edits[0].op === 'set_prompt' && motiongen.cast.one.info.edits[0].latency_ms")
    assert page.run("return document.activeElement === drop")
    page.press(Keys.ENTER)
    page.until("motiongen.cast.one.info.targets[0].state === 'removed'")
    assert page.complaints() == []


def test_focus_stays_on_a_name_that_is_chosen(page: Page) -> None:
    page.run("document.getElementById('add').click()")
    page.until("motiongen.cast.members.size === 2")
    page.run("motiongen.cast.choose(1); globalThis.names = document.querySelectorAll('#people .who'); names[1].focus()")
    page.press(Keys.ENTER)
    page.until("motiongen.cast.chosen === Number(names[1].parentElement.dataset.number)")
    assert page.run("return document.activeElement === names[1]")
    selected = page.run("return [...document.querySelectorAll('#people li')].map((each) => each.ariaSelected)")
    assert selected == ["false", "true"]


def test_keys_steer_after_a_box_was_ticked(page: Page) -> None:
    page.driver.find_element(By.ID, "keep-prompt").click()
    assert page.run("return document.activeElement.id") == "keep-prompt"
    page.keys.key_down("w").perform()
    page.until("motiongen.velocity._last")
    page.keys.key_up("w").perform()
    page.until("motiongen.velocity._last === null")
    page.press(" ")  # handled by the box itself
    assert not page.run("return document.getElementById('keep-prompt').checked")
    assert not page.run("return motiongen.cast.one.info.is_paused")


def test_held_key_pauses_once(page: Page) -> None:
    page.run(LISTEN)
    press = (
        "document.body.dispatchEvent(new KeyboardEvent('keydown', { key: ' ', bubbles: true, repeat: arguments[0] }))"
    )
    for repeat in (False, True, True):
        page.run(press, repeat)
    assert page.run("return said") == [{"op": "pause"}]


def test_keys_whose_release_a_mac_does_not_report_are_released(page: Page) -> None:
    page.run("document.getElementById('stage').focus()")
    page.keys.key_down("w").perform()
    page.until("motiongen.velocity._last")
    page.run("dispatchEvent(new KeyboardEvent('keyup', { key: 'Meta', code: 'MetaLeft' }))")
    page.until("motiongen.velocity._last === null")
    page.keys.key_up("w").perform()


def scheduled_span(page: Page) -> tuple[int, int]:
    """Schedule a prompt span. Returns its position in the window."""
    page.pause()
    page.run("motiongen.timeline._view.seconds = 25")
    page.until_drawn()
    at = page.run("return Math.floor(motiongen.cast.one.track.playhead()) + 120")
    page.tell(op="set_prompt", preset="wave-both", frame=at, end_frame=at + 60)
    page.until("motiongen.cast.one.info.spans.find(({ scheduled }) => scheduled)")
    page.until_drawn()
    x, y = page.run(
        """
        const box = document.getElementById("timeline-canvas").getBoundingClientRect();
        return [Math.round(box.left + motiongen.timeline._view.toX(arguments[0] + 30)), Math.round(box.top + 46)];
        """,
        at,
    )
    return x, y


def test_span_can_be_dragged_again_before_the_first_drag_is_answered(page: Page) -> None:
    x, y = scheduled_span(page)
    page.run(LISTEN)
    page.drag((x, y), (x + 60, y))
    page.until("said.length === 1")
    again = ActionBuilder(page.driver, duration=50)
    again.pointer_action.move_to_location(x, y).pointer_down().move_to_location(x + 30, y)
    again.perform()
    page.run("answer({})")
    page.until_drawn()
    then = ActionBuilder(page.driver, duration=50)
    then.pointer_action.move_to_location(x + 90, y).pointer_up()
    then.perform()
    page.until("said.length === 2")
    first, second = page.run("return said.map(({ frame }) => frame)")
    assert second > first
    assert page.complaints() == []


def test_released_span_does_not_follow_the_pointer(page: Page) -> None:
    x, y = scheduled_span(page)
    page.run(LISTEN)
    page.drag((x, y), (x + 60, y))
    page.until("said.length === 1")
    where = "return motiongen.timeline._sent.start"
    start = page.run(where)
    away = ActionBuilder(page.driver, duration=50)
    away.pointer_action.move_to_location(x - 60, y)
    away.perform()
    assert page.run(where) == start
    page.drag((x - 100, y + 30), (x - 110, y + 30))  # only looks at another frame
    assert page.run("return said.length") == 1
    assert page.complaints() == []


def test_right_button_moves_nothing_on_the_timeline(page: Page) -> None:
    page.until("motiongen.cast.one.track.playhead() > 20")
    canvas = page.driver.find_element(By.ID, "timeline-canvas")
    page.keys.context_click(canvas).perform()
    page.press(Keys.ESCAPE)
    assert page.run("return motiongen.timeline.seek === null && !motiongen.timeline._isSeeking")


@pytest.mark.parametrize("end", ["choose", "cancel", "tool"])
def test_interrupted_drag_of_a_pose_sends_nothing(page: Page, end: str) -> None:
    """The pose belongs to the character that was chosen, and must not be applied to another one."""
    page.run("document.getElementById('add').click()")
    page.until("motiongen.cast.members.size === 2")
    page.run("motiongen.cast.choose(1)")
    page.pause()
    page.tool("pose")
    page.run(LISTEN)
    page.run(
        "motiongen.stage.canvas.addEventListener('pointerdown', (event) => (globalThis.pointer = event.pointerId))"
    )
    x, z = page.root()
    start, stop = page.ground(x, z), page.ground(x + 0.5, z + 0.6)
    down = ActionBuilder(page.driver, duration=50)
    down.pointer_action.move_to_location(*start).pointer_down().move_to_location(*stop)
    down.perform()
    assert page.run("return Boolean(motiongen.tools._drag)")
    page.run(
        {
            "choose": "motiongen.cast.choose([...motiongen.cast.members.keys()].at(-1))",
            "cancel": "motiongen.stage.canvas.dispatchEvent(new PointerEvent('pointercancel', { pointerId: pointer }))",
            "tool": "motiongen.tools.choose('path')",
        }[end]
    )
    assert page.run("return motiongen.tools._drag") is None
    up = ActionBuilder(page.driver, duration=50)
    up.pointer_action.move_to_location(start[0] + 3, start[1]).pointer_up()
    up.perform()
    assert page.run("return said") == []
    page.run("motiongen.tools.choose('walk')")
    assert page.complaints() == []


def test_unfinished_path_is_removed_when_its_tool_changes(page: Page) -> None:
    page.pause()
    page.tool("path")
    x, z = page.root()
    down = ActionBuilder(page.driver, duration=50)
    down.pointer_action.move_to_location(*page.ground(x, z + 0.4)).pointer_down()
    down.pointer_action.move_to_location(*page.ground(x + 1.0, z + 1.4))
    down.perform()
    points = "return motiongen.tools._drawn.geometry.getAttribute('position')?.count ?? 0"
    assert page.run(points) > 0
    page.press("1")
    assert page.run(points) == 0
    up = ActionBuilder(page.driver)
    up.pointer_action.pointer_up()
    up.perform()
    assert page.complaints() == []


OTHER_RIG = """
    const [changes, done] = arguments, { rig } = motiongen.cast.one;
    const described = {
      id: "other", joints: rig.joints.map((_, n) => `joint_${n}`), parents: rig.parents,
      offsets_m: rig.offsets.map((each) => each.toArray()), frame_rate_hz: 20, row_width: rig.rowWidth,
      columns: rig.columns, limbs: rig.limbs, hip_joints: rig.hipJoints, ...changes,
    };
    import("/motion/rig.js").then(({ Rig }) => done((globalThis.other = new Rig(described)).id));
"""
"""The rig of the chosen character with other joint names."""


def test_hands_and_feet_are_found_by_limb_whatever_the_joint_names(page: Page) -> None:
    page.driver.execute_async_script(OTHER_RIG, {})
    ends, feet, same = page.run(
        """
        const { rig } = motiongen.cast.one, names = (joints) => joints.map((joint) => rig.joints[joint]);
        return [names(rig.ends), names(rig.feet), `${rig.ends} ${rig.feet}` === `${other.ends} ${other.feet}`];
        """
    )
    assert sorted(ends) == ["LeftFoot", "LeftHand", "RightFoot", "RightHand"]
    assert feet == ["LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase"]
    assert same


def test_rig_without_feet_has_no_handles_for_them(page: Page) -> None:
    page.pause()
    page.tool("limb")
    page.until("motiongen.tools._handles.children.length === 4")
    page.driver.execute_async_script(OTHER_RIG, {"limbs": {}})
    shown = page.run(
        """
        const { tools, marks, cast, plots } = motiongen, { one } = cast, place = one.track.playhead();
        const member = { ...one, rig: other };
        tools.update(member);
        marks.update(member, place, one.track.sample(place), performance.now());
        plots.draw(member, place, Infinity);
        return [tools._handles.children.length, marks._feet.filter(({ visible }) => visible).length];
        """
    )
    assert shown == [0, 0]
    feet = page.run(
        """
        const { cast } = motiongen, { one } = cast, { rig } = one;
        const offered = [other, rig].map((each) => {
          one.rig = each;
          cast.dispatchEvent(new Event("choice"));
          return document.getElementById("target-limb").options.length;
        });
        return offered;
        """
    )
    assert feet == [0, 2]
    page.until("motiongen.tools._handles.children.length === 4")
    page.run("motiongen.tools.choose('walk')")
    assert page.complaints() == []


def test_margins_have_the_same_duration_at_any_frame_rate(page: Page) -> None:
    told = page.driver.execute_async_script(
        """
        const done = arguments[0], { one } = motiongen.cast;
        import("/steer/commands.js").then(({ frameIn, leadFrames }) => done([10, 20, 60].map((frameRate) => {
          const track = { playhead: () => 0, committedTo: 100 };
          const member = { ...one, rig: { frameRate }, info: { edits: [] }, track };
          return [frameIn(member, 0) - 100, leadFrames(member)];
        })));
        """
    )
    assert told == [[8, 12], [8, 12], [24, 36]]


def test_playhead_jumps_after_the_same_time_at_any_frame_rate(page: Page) -> None:
    places = page.driver.execute_async_script(
        """
        const done = arguments[0];
        import("/motion/track.js").then(({ Track }) => done([20, 60].map((frameRate) => {
          const track = new Track({ rowWidth: 1, frameRate });
          track.put(0, Array.from({ length: 100 }, () => new Float32Array(1)));
          for (const place of [10, 16]) track.setHead(place, frameRate, 0, 0);
          return track.playhead(0);
        })));
        """
    )
    assert places[0] == 16, "0.3 s"
    assert 10 < places[1] < 11, "0.1 s, which is caught up gradually"


def test_history_is_requested_once_while_the_pointer_moves(page: Page) -> None:
    page.until("motiongen.cast.one.track.playhead() > 60")
    page.driver.refresh()
    page.until_shown()
    page.pause()
    asked = page.run(
        """
        const { cast, timeline } = motiongen, askHistory = cast.askHistory.bind(cast);
        globalThis.asked = 0;
        cast.askHistory = (...what) => (asked++, askHistory(...what));
        for (const frame of [40, 30, 20, 10, 5]) timeline.lookAt(frame);
        return [asked, cast.one.track.first];
        """
    )
    assert asked[0] == 1
    assert asked[1] > 40
    page.until("motiongen.cast.one.track.first === 0")
    page.run("motiongen.timeline.goLive()")
    assert page.complaints() == []
