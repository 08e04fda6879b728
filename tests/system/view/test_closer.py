"""In Chromium: trails of root and joints, the replaced plan, and plots that end at the residual."""

from __future__ import annotations

from pathlib import Path

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select

from tests.system.view.chromium import Page

pytestmark = pytest.mark.system

# the points of a line on the stage
LINE = """
const { marks, cast } = motiongen;
const drawn = marks[arguments[0]];
if (!drawn.visible) return null;
const places = drawn.geometry.getAttribute("position").array;
const count = drawn.geometry.drawRange.count;
return Array.from({ length: count }, (_, n) => [...places.slice(3 * n, 3 * n + 3)]);
"""


def line(page: Page, name: str) -> list[list[float]]:
    return page.run(LINE, name) or []


def test_joint_trail_is_drawn_beside_the_root_trail(page: Page, pictures: Path) -> None:
    page.run("document.querySelector('[data-preset=wave-both]').click()")
    page.until("motiongen.cast.one.track.playhead() > 150")
    assert line(page, "_jointTrail") == []
    Select(page.driver.find_element(By.ID, "trail-joint")).select_by_visible_text("RightHand")
    page.pause()
    page.until_drawn()
    hand, root = line(page, "_jointTrail"), line(page, "_trail")
    assert len(hand) == len(root) == 81, "four seconds at twenty frames a second, and the present frame"
    assert min(y for _, y, _ in hand) > 1, "a waving hand is high"
    assert {round(y, 3) for _, y, _ in root} == {0.01}
    here = page.run(
        """
        const { cast, timeline } = motiongen, { rig, track } = cast.one;
        rig.pose(track.row(Math.floor(timeline.place(cast.one))));
        const joint = rig.joints.indexOf("RightHand");
        return [...rig.positions.slice(3 * joint, 3 * joint + 3)];
        """
    )
    assert hand[-1] == pytest.approx(here, abs=0.05), "a frame may have passed"
    page.picture(pictures / "trail.png")


def test_replaced_plan_is_shown_for_a_while(page: Page) -> None:
    page.run("document.querySelector('[data-preset=walk]').click()")
    page.until("motiongen.cast.one.track.playhead() > 60")
    page.tell(
        op="add_constraints",
        constraints=[{"kind": "waypoint", "x_m": -2, "z_m": 0, "frame": 90, "frames_from_effect": True}],
    )
    replaced = page.until("motiongen.marks._ghost.visible && motiongen.marks._ghost.geometry.drawRange.count")
    assert replaced > 1
    page.until("!motiongen.marks._ghost.visible")


def test_plots_follow_the_motion_and_end_at_the_residual(page: Page, pictures: Path) -> None:
    x, z = page.root()
    target = {"kind": "waypoint", "x_m": x, "z_m": z + 2.0, "frame": 100, "frames_from_effect": True}
    page.tell(op="add_constraints", constraints=[target])
    page.until("motiongen.plots.drawn.ways.some((way) => way > 1)")
    settled = page.settled_target("waypoint")
    page.until("motiongen.cast.one.track.playhead() > arguments[0]", settled["last"] + 10)
    ways = [way for way in page.run("return motiongen.plots.drawn.ways") if way is not None]
    speeds = page.run("return motiongen.plots.drawn.speeds")
    assert max(ways) > 1.5
    assert ways[-1] == pytest.approx(settled["position_error_m"], abs=0.01)
    assert 0.3 < max(speeds) < 3
    painted = """
        const canvas = motiongen.plots.element.querySelector("canvas");
        return canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((each) => each > 0);
    """
    assert page.run(painted)
    page.picture(pictures / "plots.png")
    assert page.complaints() == []
