"""Take the pictures of docs/viewer.md and docs/gallery.md again: `python -m tests.system.view.pictures`.

Use an idle machine: on a busy one the pictures show underruns and late edits.
"""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path

from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

from motiongen_tools.cli import run
from motiongen_tools.server_process import ServerProcess
from tests.system.view.chromium import Page, start_chromium, viewer

PICTURES = Path(__file__).parents[3] / "docs" / "pictures"
SIZE = (1280, 860)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.system.view.pictures", description=__doc__)
    parser.add_argument("--out", type=Path, default=PICTURES, metavar="FOLDER", help="default: docs/pictures")
    parser.add_argument("--only", default="stage,tools,compare,crowd,phone,gallery", help="of %(default)s")
    parser.add_argument("--server", metavar="HOST:PORT", help="one that runs, in place of one of its own")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    wanted = options.only.split(",")
    with contextlib.ExitStack() as stack:
        running = options.server
        if running is None:
            running = stack.enter_context(ServerProcess(["--admit-load", "1000", "--drain-wait-s", "0"])).address
        with viewer(running) as (address,):
            for name, take in (("stage", stage), ("tools", tools), ("compare", compare), ("crowd", crowd)):
                if name in wanted:
                    _taken(take, f"{address}?room={name}", options.out)
            if "phone" in wanted:
                _taken(phone, f"{address}?room=phone", options.out)
        if "gallery" in wanted:
            gallery(running, options.out)


def _taken(take: object, address: str, out: Path) -> None:
    driver = start_chromium(size=SIZE)
    try:
        page = Page(driver, address)
        page.until_shown()
        # With software rendering, at two frames per second: shadows and resolution stay at their best all the same.
        page.run("motiongen.stage.adapt = () => {}")
        assert callable(take)
        take(page, out)
        complaints = page.complaints()
        print(f"{take.__name__}: {'; '.join(complaints) or 'taken'}", flush=True)
        page.run("for (const n of motiongen.cast.members.keys()) motiongen.cast.ask({ op: 'remove', character: n })")
        page.until("motiongen.cast.members.size === 0")
    finally:
        driver.quit()


def stage(page: Page, out: Path) -> None:
    """A walk to a place, then a wave; the whole page, the timeline and the panel."""
    place = {"kind": "waypoint", "frame": 0, "at_any_frame": True, "x_m": 1.2, "z_m": 2}
    page.tell(op="add_constraints", constraints=[place])
    target = page.settled_target("waypoint")
    page.tell(op="set_prompt", preset="wave-both")
    accepted = "motiongen.cast.one.info.edits.find(({ op, effective_frame }) => op === 'set_prompt' && effective_frame)"
    edit = page.until(accepted)
    frame = edit["effective_frame"] + 200  # still in the future, even if the picture is late
    page.tell(op="set_prompt", preset="walk", frame=frame, end_frame=frame + 60)
    page.until("motiongen.cast.one.track.playhead() > arguments[0]", max(target["last"], edit["effective_frame"]) + 30)
    page.until_drawn()
    page.picture(out / "viewer.png")
    page.driver.find_element(By.ID, "timeline").screenshot(str(out / "viewer-timeline.png"))
    page.driver.find_element(By.ID, "inspect").screenshot(str(out / "viewer-edits.png"))


def tools(page: Page, out: Path) -> None:
    """The ring, the handles at hands and feet, the ghost, and targets in numbers."""
    page.pause()
    canvas = page.driver.find_element(By.ID, "stage")
    for name in ("face", "limb"):
        page.tool(name)
        canvas.screenshot(str(out / f"viewer-{name}.png"))
    page.tool("pose")
    x, z = page.root()
    page.drag(page.ground(x, z), page.ground(x + 0.6, z + 0.8))
    page.until_drawn()
    canvas.screenshot(str(out / "viewer-pose.png"))
    page.go_on()
    page.run("document.getElementById('clear').click()")
    for panel in ("target-panel", "options-panel"):
        page.run("document.getElementById(arguments[0]).open = true", panel)
        page.run("document.getElementById(arguments[0]).scrollIntoView()", panel)
        page.driver.find_element(By.ID, panel).screenshot(str(out / f"viewer-{panel}.png"))
        page.run("document.getElementById(arguments[0]).open = false", panel)


def compare(page: Page, out: Path) -> None:
    """The same take with 4 steps and with 10."""
    page.run("document.querySelector('[data-preset=walk]').click()")
    page.until("motiongen.cast.one.track.playhead() > 120")
    page.run("document.getElementById('compare-panel').open = true")
    page.driver.find_element(By.ID, "again-steps").send_keys("10")
    page.run("document.getElementById('again').click()")
    page.until("motiongen.cast.members.size === 2 && !motiongen.cast.members.get(2).info.is_rehearsing")
    page.run("document.getElementById('compare').click(); document.getElementById('inspect').scrollTop = 260")
    page.run("motiongen.timeline.lookAt(110)")
    page.until("motiongen.compare.frame === 110")
    for _ in range(8):  # the camera follows
        page.until_drawn()
    page.picture(out / "viewer-compare.png")
    Select(page.driver.find_element(By.ID, "compare-how")).select_by_value("over")
    page.until_drawn()
    page.driver.find_element(By.ID, "stage").screenshot(str(out / "viewer-laid-over.png"))


def crowd(page: Page, out: Path) -> None:
    """Twenty characters."""
    for preset in ("walk", "wave-both", "run", "raise-left"):
        page.run("motiongen.cast.ask({ op: 'add', count: 5, preset: arguments[0], priority: 'crowd' })", preset)
    page.until("motiongen.cast.members.size === 21")
    page.press("f", "l")
    page.run("motiongen.stage.frame(motiongen.stage.camera.position.clone().set(0, 0, 0), 0, 2.6)")
    page.until("[...motiongen.cast.members.values()].every(({ track }) => track.playhead() > 30)")
    page.until_drawn()
    page.picture(out / "viewer-crowd.png")


def phone(page: Page, out: Path) -> None:
    """The page on a spectator's phone."""
    screen = {"width": 390, "height": 780, "deviceScaleFactor": 1, "mobile": True}
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    page.run("document.body.classList.add('watching')")
    page.until("!document.querySelector('#notes p')")
    page.until_drawn()
    page.until_drawn()
    page.picture(out / "viewer-phone.png")


def gallery(server: str, out: Path) -> None:
    """Targets, with two step counts."""
    path = Path("/tmp") / "motiongen-gallery.html"
    run(["gallery", "motiongen-mini", "--server", server, "--steps", "4,10", "--out", str(path)])
    driver = start_chromium(size=(1300, 1000))
    try:
        page = Page(driver, path.as_uri())
        page.until("globalThis.gallery?.pictures.some(({ isSeen }) => isSeen)")
        page.run("document.getElementById('play').click(); gallery.state.seconds = 2")
        page.run("document.getElementById('together').click(); document.getElementById('part-1').scrollIntoView()")
        page.until_drawn()
        page.until_drawn()
        page.picture(out / "gallery.png")
    finally:
        driver.quit()
        path.unlink()


if __name__ == "__main__":
    main()
