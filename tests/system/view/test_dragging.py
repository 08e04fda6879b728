"""In Chromium: dragged hands, feet, poses, headings and paths become targets, and are met with the error shown."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.system.view.chromium import Page

pytestmark = [pytest.mark.system, pytest.mark.timeout(500)]

JOINT = "const m = motiongen.cast.one; const row = m.track.row(arguments[1]); m.rig.pose(row);" \
    " const p = m.rig.position(m.rig.joints.indexOf(arguments[0])); return [p.x, p.y, p.z]"  # fmt: skip


def drag_a_limb(page: Page, joint: str, by: tuple[int, int]) -> None:
    page.pause()
    page.tool("limb")
    start = page.at("const p = motiongen.tools.handleAt(arguments[0]); return { x: p.x, y: p.y, z: p.z }", joint)
    page.drag(start, (start[0] + by[0], start[1] + by[1]))
    page.go_on()


@pytest.mark.parametrize(("joint", "by"), [("RightHand", (10, -40)), ("LeftFoot", (12, -14))])
def test_dragged_limb_reaches_its_target(page: Page, pictures: Path, joint: str, by: tuple[int, int]) -> None:
    drag_a_limb(page, joint, by)
    target = page.settled_target("joint_targets")
    page.picture(pictures / f"dragged-{joint}.png")
    asked = np.array(target["spec"]["positions_m"][-1])
    page.until("motiongen.cast.one.track.end > arguments[0]", target["last"])
    there = np.array(page.run(JOINT, joint, target["last"]))
    assert np.linalg.norm(there - asked) <= target["position_error_m"] + 2e-3
    assert target["state"] == "met"
    assert page.complaints() == []


def test_dragged_pose_is_reached(page: Page, pictures: Path) -> None:
    page.pause()
    page.tool("pose")
    x, z = page.root()
    start, end = page.ground(x, z), page.ground(x + 0.5, z + 0.6)
    page.drag(start, end)
    page.go_on()
    target = page.settled_target("keyframe")
    page.picture(pictures / "dragged-pose.png")
    root = target["spec"]["positions_m"][0]
    assert math.hypot(root[0] - x - 0.5, root[2] - z - 0.6) < 0.1  # one pixel is two centimetres there
    assert target["position_error_m"] < 0.1
    assert page.complaints() == []


def test_turning_the_ring_turns_the_character(page: Page, pictures: Path) -> None:
    page.pause()
    page.tool("face")
    x, z = page.root()
    start = page.at("const p = motiongen.tools.handleAt('ring'); return { x: p.x, y: p.y, z: p.z }")
    page.drag(start, page.ground(x + 1.0, z))
    page.go_on()
    target = page.settled_target("heading")
    page.picture(pictures / "turned-ring.png")
    assert target["spec"]["heading_rad"] == pytest.approx(math.pi / 2, abs=0.1)
    assert target["state"] == "met"
    assert page.complaints() == []


def test_drawn_path_is_walked(page: Page, pictures: Path) -> None:
    page.pause()
    page.tool("path")
    x, z = page.root()
    page.drag(page.ground(x, z + 0.4), page.ground(x + 1.2, z + 1.6))
    target = page.until("motiongen.cast.one.info.targets.findLast(({ spec, last }) => spec.kind === 'path' && last)")
    corners = np.array(target["spec"]["corners_m"])
    np.testing.assert_allclose(corners[-1], [x + 1.2, z + 1.6], atol=0.1)
    page.picture(pictures / "drawn-path.png")
    page.run("document.getElementById('clear').click()")
    page.until("motiongen.cast.one.info.targets.every(({ state }) => state !== 'waiting')")
    page.run("document.getElementById('undo').click()")
    page.until("motiongen.cast.one.info.targets.some(({ spec, state }) => spec.kind === 'path' && state === 'waiting')")
    page.go_on()
    again = page.settled_target("path")
    assert again["state"] == "met"
    assert page.complaints() == []
