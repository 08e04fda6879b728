"""In Chromium: a take is generated again, with more steps or another model, and compared frame by frame.

Saved files are opened again.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

from motiongen_ardy.checkpoint.model_card import BUILT_IN_MODEL
from motiongen_tools.server_process import ServerProcess
from tests.conftest import ROOT
from tests.system.view.chromium import Page, viewer

pytestmark = [pytest.mark.system, pytest.mark.timeout(500)]

RAW_FEET = "raw-feet"
BUILT_IN = ROOT / "ardy" / "pretrained" / BUILT_IN_MODEL
SLIDES = """
const [last, done] = arguments;
import('/ui/plots.js').then(({ figures }) =>
  done([...motiongen.cast.members.values()].map((one) => figures(one, last).slides)));
"""  # speeds, m/s, of feet that are in contact, as the page plots them


def test_take_is_generated_again_with_ten_steps_and_compared(page: Page, pictures: Path) -> None:
    page.driver.find_element(By.CSS_SELECTOR, "[data-preset=wave-both]").click()
    said = page.until("motiongen.cast.one.info.edits.find(({ effective_frame }) => effective_frame !== null)")
    page.until("motiongen.cast.one.track.playhead() > arguments[0] + 20", said["effective_frame"])
    page.run("document.getElementById('compare-panel').open = true")
    page.driver.find_element(By.ID, "again-steps").send_keys("10")
    page.run("document.getElementById('again').click()")
    page.until("motiongen.cast.members.size === 2")
    first, again = page.run("return [...motiongen.cast.members.values()].map(({ info }) => info)")
    assert again["seed"] == first["seed"]
    assert (first["steps"], again["steps"]) == (4, 10)
    page.until("!motiongen.cast.members.get(2).info.is_rehearsing")
    told = page.run("return motiongen.cast.members.get(2).info.edits")
    assert [edit["what"] for edit in told if edit["op"] == "set_prompt"] == [said["what"]]
    assert page.run("return motiongen.cast.members.get(2).info.failure") == ""
    page.run("document.getElementById('compare').click()")
    page.until("motiongen.compare.frame > 10")
    assert page.run("return motiongen.compare.pair.map(({ number }) => number)") == [1, 2]
    page.until("document.getElementById('compare-said').value.includes('joints')")
    bones = page.run("return motiongen.cast.one.rig.bones.length")
    page.until("motiongen.bodies.mesh.count === 2 * arguments[0]", bones)
    page.picture(pictures / "side-by-side.png")
    Select(page.driver.find_element(By.ID, "compare-how")).select_by_value("over")
    page.until("motiongen.bodies.mesh.count === arguments[0]", bones)  # the other one is drawn as a ghost
    page.picture(pictures / "laid-over.png")
    page.run("motiongen.timeline.lookAt(15)")
    page.until("motiongen.compare.frame === 15")
    page.run("document.getElementById('compare').click()")
    assert page.run("return motiongen.compare.pair") is None
    assert page.complaints() == []


def test_saved_files_are_opened_again(page: Page, tmp_path: Path) -> None:
    page.driver.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)})
    page.tell(
        op="add_constraints",
        constraints=[{"kind": "heading", "frame": 30, "frames_from_effect": True, "heading_rad": 1}],
    )
    target = page.settled_target("heading")
    page.until("motiongen.cast.one.track.playhead() > arguments[0]", target["last"] + 2)
    for name in ("glb", "session.json", "constraints.json"):
        page.run("document.querySelector(`[data-take='${arguments[0]}']`).click()", name)
        saved = tmp_path / f"character-1.{name}"
        while not saved.exists():
            page.run("return 0")  # until the browser has written it
        page.driver.find_element(By.ID, "open-file").send_keys(str(saved))
        page.until("document.getElementById('open-file').value === ''")
    (entry,) = json.loads((tmp_path / "character-1.constraints.json").read_text())
    assert entry["global_root_heading"] == [1]
    page.until("motiongen.takes.opened.length === 1")  # the glTF, as its own scene
    assert page.run("return motiongen.takes.opened[0].numFrames") > 60
    page.until("motiongen.cast.members.size === 2")  # the character that replays the session file
    page.until("motiongen.cast.one.info.targets.filter(({ spec }) => spec.kind === 'trajectory').length === 1")
    page.until("motiongen.cast.members.get(2).info.targets.some(({ spec }) => spec.kind === 'heading')")
    assert page.complaints() == []


def test_file_of_another_frame_rate_is_compared_at_the_same_time(page: Page, tmp_path: Path) -> None:
    page.until("motiongen.cast.one.track.playhead() > 40")
    joints = page.run("return motiongen.cast.one.rig.joints.length")
    saved = tmp_path / "slow.npz"
    rotations = np.tile(np.eye(3, dtype=np.float32), (4, joints, 1, 1))
    root = np.array([[0, 1, second / 2] for second in range(4)], np.float32)
    np.savez(saved, local_rot_mats=rotations, root_positions=root, fps=2.0)  # two frames a second
    page.driver.find_element(By.ID, "open-file").send_keys(str(saved))
    page.until("motiongen.takes.opened.length === 1")
    page.run("const [file] = motiongen.takes.opened; file.draw = (_bodies, place) => { file.drawn = place; }")
    page.run("document.getElementById('compare-panel').open = true")
    page.run("document.getElementById('compare').click()")
    rate = page.run("return motiongen.cast.one.rig.frameRate")
    page.until("motiongen.compare.frame >= arguments[0]", rate)  # the file's frame 2, of 4
    page.run("motiongen.timeline.lookAt(arguments[0])", rate)
    page.until("motiongen.compare.frame === arguments[0]", rate)
    page.until_drawn()
    assert page.run("return motiongen.takes.opened[0].drawn") == 2
    page.run("motiongen.timeline.lookAt(arguments[0])", 10 * rate)
    page.until("motiongen.compare.frame === 1.5 * arguments[0]", rate)  # where the file ends
    assert page.complaints() == []


@pytest.fixture(scope="module")
def with_and_without(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a page on a server with the built-in model twice: with and without the clean-up of feet."""
    raw = tmp_path_factory.mktemp("models") / RAW_FEET
    shutil.copytree(BUILT_IN, raw)
    for name, old, new in (
        ("sampling.yaml", "clean_feet: true", "clean_feet: false"),
        ("MODEL_CARD.md", f"name: {BUILT_IN_MODEL}", f"name: {RAW_FEET}"),
    ):
        text = (raw / name).read_text(encoding="utf-8")
        assert old in text
        (raw / name).write_text(text.replace(old, new), encoding="utf-8")
    settings = ["--devices", "cpu:1", "--profile-s", "0.5", "--admit-load", "1000", "--drain-wait-s", "0"]
    with (
        ServerProcess([*settings, "--model", BUILT_IN_MODEL, "--model", str(raw)]) as server,
        viewer(server.address) as (address,),
    ):
        yield address


def test_take_is_generated_again_without_the_clean_up_of_feet(
    with_and_without: str, open_page: Callable[..., Page], pictures: Path
) -> None:
    page = open_page(with_and_without)
    page.until_shown()
    page.driver.find_element(By.CSS_SELECTOR, "[data-preset=walk]").click()
    page.until("motiongen.cast.one.track.playhead() > 120")
    page.run("document.getElementById('compare-panel').open = true")
    Select(page.driver.find_element(By.ID, "again-model")).select_by_value(RAW_FEET)
    page.run("document.getElementById('again').click()")
    page.until("motiongen.cast.members.size === 2 && !motiongen.cast.members.get(2).info.is_rehearsing")
    first, again = page.run("return [...motiongen.cast.members.values()].map(({ info }) => info)")
    assert (again["model"], again["seed"]) == (RAW_FEET, first["seed"])
    page.run("document.getElementById('compare').click()")
    page.until("document.getElementById('compare-said').value.includes('joints')")
    page.picture(pictures / "with-and-without-clean-up.png")
    cleaned, raw = page.driver.execute_async_script(SLIDES, 120)
    assert len(cleaned) == len(raw) > 60
    assert np.mean(cleaned) < np.mean(raw) / 2
    assert page.complaints() == []
