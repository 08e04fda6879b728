"""In Chromium: what has no handle on the stage is entered as numbers: frames, weights, tolerances, options, cuts."""

from __future__ import annotations

import math
from typing import Any

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

from tests.system.view.chromium import Page

pytestmark = [pytest.mark.system, pytest.mark.timeout(500)]


def fill(page: Page, **values: Any) -> None:
    """Set fields of the form, given by their ids, as a user would."""
    for name, value in values.items():
        page.run(
            """
            const field = document.getElementById(arguments[0].replaceAll('_', '-'));
            if (field.type === 'checkbox') field.checked = arguments[1];
            else field.value = arguments[1];
            field.dispatchEvent(new Event('change', { bubbles: true }));
            """,
            name,
            value,
        )


def last_edit(page: Page, number: int) -> dict[str, Any]:
    """The edit with that number, once it is answered."""
    edit: dict[str, Any] = page.until(
        "motiongen.cast.one.info.edits.find(({ number, state }) => number === arguments[0] && state !== 'sent')", number
    )
    return edit


def test_every_field_of_a_target_form_is_applied(page: Page) -> None:
    page.run("document.getElementById('target-panel').open = true")
    add = page.driver.find_element(By.ID, "target-add")
    fill(page, target_kind="place", target_x=0.5, target_z=1, target_heading=90, target_when="within")
    fill(page, target_from=2, target_to=4, target_weight=2, target_tolerance=15, target_tolerance_turn=20)
    page.run("arguments[0].click()", add)
    assert last_edit(page, 1)["state"] == "accepted"
    spec = page.run("return motiongen.cast.one.info.targets.at(-1).spec")
    assert spec["last_frame"] - spec["frame"] >= 30
    assert (spec["weight"], spec["tolerance_m"]) == (2, 0.15)
    assert spec["heading_rad"] == pytest.approx(math.pi / 2)
    fill(page, target_when="soon", target_relative=True, target_heading="", target_weight="", target_alone=True)
    page.run("arguments[0].click()", add)
    assert last_edit(page, 2)["state"] == "accepted"
    states = page.run("return motiongen.cast.one.info.targets.map(({ state }) => state)")
    assert states == ["removed", "waiting"]  # it replaces all others
    fill(page, target_kind="height", target_y=0.8, target_when="after", target_from=2, target_alone=False)
    page.run("arguments[0].click()", add)
    assert last_edit(page, 3)["state"] == "accepted"
    fill(page, target_kind="foot", target_limb="LeftFoot", target_x=0.1, target_z=0.2, target_relative=False)
    page.run("arguments[0].click()", add)
    assert last_edit(page, 4)["state"] == "accepted"
    fill(page, target_kind="path", target_corners="0,2 2,2")
    page.run("arguments[0].click()", add)
    assert last_edit(page, 5)["state"] == "accepted"
    fill(page, target_corners="0;2")
    page.run("arguments[0].click()", add)
    page.until(
        "[...document.querySelectorAll('#notes p.error')].some(({ textContent }) => textContent.includes('0;2'))"
    )
    assert page.complaints() == []


def test_options_and_cuts_are_applied(page: Page) -> None:
    page.run("document.getElementById('options-panel').open = true")
    page.run("document.getElementById('option-steps').value = 2; document.getElementById('options-set').click()")
    assert last_edit(page, 1)["state"] == "accepted"
    page.run("document.getElementById('option-steps').value = 99; document.getElementById('options-set').click()")
    refused = last_edit(page, 2)
    assert refused["state"] == "refused"
    assert "99" in refused["detail"]
    fill(page, put_x=5, put_z=-3, put_heading=90)
    page.run("document.getElementById('put').click()")
    cut = last_edit(page, 3)
    page.until("motiongen.cast.one.track.playhead() > arguments[0] + 2", cut["effective_frame"])
    x, z = page.root()
    assert math.hypot(x - 5, z + 3) < 0.3
    page.run("motiongen.timeline.lookAt(30)")
    page.run("document.getElementById('cut').click()")
    back = last_edit(page, 4)
    assert back["state"] == "accepted"
    page.until("motiongen.cast.one.track.playhead() > arguments[0] + 2", back["effective_frame"])
    x, z = page.root()
    assert math.hypot(x - 5, z + 3) > 3  # back near the place before it was moved
    assert page.complaints() == []


def test_characters_are_opened_with_the_given_options(page: Page) -> None:
    page.run("document.querySelector('#people details').open = true")
    fill(page, add_steps=2, add_seed="18446744073709551615", add_count=1)
    Select(page.driver.find_element(By.ID, "add-priority")).select_by_value("hero")
    page.run("document.getElementById('add').click()")
    info = page.until("motiongen.cast.members.get(2)?.info")
    assert (info["steps"], info["seed"]) == (2, "18446744073709551615")
