"""In Chromium: contrast in light and dark themes, use by keyboard, a spectator's phone, a background window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from selenium.webdriver.common.keys import Keys

from motiongen_tools.server_process import ServerProcess
from tests.system.view.chromium import Page, viewer

pytestmark = [pytest.mark.system, pytest.mark.timeout(500)]

LEAST_CONTRAST = 4.5
"""Least contrast of text, by level AA of the Web Content Accessibility Guidelines 2.2, success criterion 1.4.3."""

# Every element with text of its own, and the contrast to its background. Panels are translucent, so they are tried over
# the darkest and the lightest background that the stage can be.
CONTRASTS = """
const numbers = (colour) => colour.match(/[\\d.]+/g).map(Number);
const canvas = new OffscreenCanvas(1, 1), context = canvas.getContext('2d', { willReadFrequently: true });
const over = (layers) => {
  context.clearRect(0, 0, 1, 1);
  for (const layer of layers) { context.fillStyle = layer; context.fillRect(0, 0, 1, 1); }
  return [...context.getImageData(0, 0, 1, 1).data].slice(0, 3);
};
const luminance = (rgb) => rgb.map((each) => each / 255)
  .map((each) => (each <= 0.04045 ? each / 12.92 : ((each + 0.055) / 1.055) ** 2.4))
  .reduce((sum, each, n) => sum + each * [0.2126, 0.7152, 0.0722][n], 0);
const contrast = (a, b) => {
  const [low, high] = [luminance(a), luminance(b)].sort((x, y) => x - y);
  return (high + 0.05) / (low + 0.05);
};
const found = [];
for (const each of document.querySelectorAll('body *')) {
  const words = [...each.childNodes].filter((node) => node.nodeType === 3 && node.textContent.trim());
  const says = words.length || each.matches('input');
  if (!says || !each.checkVisibility() || each.matches(':disabled, option')) continue;
  const layers = [];
  for (let at = each; at; at = at.parentElement) layers.unshift(getComputedStyle(at).backgroundColor);
  const worst = Math.min(...arguments[0].map((behind) => {
    const ground = over([behind, ...layers.slice(2)]); // what is behind a panel is the stage, not the page
    return contrast(over([`rgb(${ground})`, getComputedStyle(each).color]), ground);
  }));
  found.push([worst, `${each.tagName} ${each.id} ${each.className} ${each.textContent.trim().slice(0, 30)}`]);
}
return found.sort(([a], [b]) => a - b);
"""
BEHIND = {"dark": ["#14171c", "#4a5360"], "light": ["#e9edf2", "#9aa6b4"]}


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_text_has_enough_contrast(open_page: Callable[..., Page], pictures: Path, theme: str) -> None:
    page = open_page()
    media = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    page.until_shown()
    assert page.run("return document.documentElement.classList.contains('light')") == (theme == "light")
    page.run("for (const each of document.querySelectorAll('details')) each.open = true")
    page.run("document.querySelector('[data-preset=walk]').click()")
    page.until("motiongen.cast.one.info.edits.length > 0")
    shown = page.run(CONTRASTS, BEHIND[theme])
    assert len(shown) > 50
    assert [each for each in shown if each[0] < LEAST_CONTRAST] == []
    page.picture(pictures / f"{theme}.png")
    page.press("l")
    assert page.run("return document.documentElement.classList.contains('light')") == (theme == "dark")


def test_page_can_be_used_with_the_keyboard_alone(page: Page) -> None:
    nameless = page.run(
        """
        const named = (each) => each.ariaLabel || each.title || each.labels?.length || each.textContent.trim();
        return [...document.querySelectorAll('button, input, select, canvas, [tabindex]')]
          .filter((each) => !named(each)).map((each) => each.outerHTML.slice(0, 90));
        """
    )
    assert nameless == []
    page.run("document.body.focus()")
    page.press("/")
    page.press("a person walks forward", Keys.ENTER)
    page.until("motiongen.cast.one.info.spans.at(-1)?.text === 'a person walks forward'")
    page.press(Keys.TAB)
    assert page.run("return document.activeElement.id") == "prompt-send"
    page.run("document.getElementById('target-panel').querySelector('summary').focus()")
    page.press(Keys.ENTER)
    page.run("document.getElementById('target-add').focus()")
    page.press(Keys.ENTER)
    page.until("motiongen.cast.one.info.targets.length === 1")
    page.run("document.getElementById('timeline-canvas').focus()")
    page.press(Keys.ARROW_LEFT, Keys.ARROW_LEFT)
    assert page.run("return motiongen.timeline.seek") is not None
    page.press(Keys.HOME)
    assert page.run("return motiongen.timeline.seek") is None
    page.run("document.activeElement.blur()")
    page.press("3")
    assert page.run("return document.getElementById('tool-limb').ariaPressed") == "true"
    page.press(" ")
    page.until("motiongen.cast.one.info.is_paused")
    page.press("?")
    assert page.run("return document.getElementById('help').open")
    page.press(Keys.ESCAPE)
    assert not page.run("return document.getElementById('help').open")
    assert page.complaints() == []


def test_spectators_phone_shows_the_stage_without_controls(
    motion_server: ServerProcess, open_page: Callable[..., Page], pictures: Path
) -> None:
    with viewer(motion_server.address, 0, "--token") as (to_steer, to_look_on):
        open_page(to_steer).until_shown()
        phone = open_page(to_look_on, size=(500, 860))
        phone.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 780, "deviceScaleFactor": 1, "mobile": True}
        )
        phone.driver.refresh()
        phone.until_shown()
        assert phone.run("return document.documentElement.scrollWidth") <= 390
        steering = "return [...document.querySelectorAll('.steering')].filter((each) => each.checkVisibility()).length"
        assert phone.run(steering) == 0
        height = phone.run("return document.getElementById('stage').clientHeight")
        assert height > 780 / 2  # the stage takes most of it
        at = phone.run("return motiongen.cast.one.track.playhead()")
        phone.until("motiongen.cast.one.track.playhead() > arguments[0] + 10", at)
        phone.picture(pictures / "phone.png")
        assert phone.complaints() == []


def test_background_window_returns_to_the_present(page: Page) -> None:
    """Browsers stop drawing a hidden page, while its messages continue to arrive."""
    before = page.run(
        """
        const draw = requestAnimationFrame.bind(window);
        globalThis.asked = [];
        globalThis.requestAnimationFrame = (act) => asked.push(act);
        globalThis.comeBack = () => {
          globalThis.requestAnimationFrame = draw;
          for (const act of asked) draw(act);
        };
        return motiongen.cast.one.track.playhead();
        """
    )
    page.until("motiongen.cast.one.track.playhead() > arguments[0] + 60", before)
    drawn = page.run("return motiongen.stage.renderer.info.render.frame")
    page.run("comeBack()")
    page.until("motiongen.stage.renderer.info.render.frame > arguments[0]", drawn)
    shown = page.run("return Number(document.getElementById('where').value.match(/playhead (\\d+)/)[1])")
    assert shown > before + 60
    assert page.complaints() == []
