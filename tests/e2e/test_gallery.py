"""A gallery made with a real server: a take for each task, with the outcome of each target."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from motiongen_client.blocking import MotionClient
from motiongen_tools.cli import run
from motiongen_tools.gallery.questions import CHANGES, TARGETS
from tests.conftest import LiveServer


def test_gallery_shows_every_kind_of_target_for_each_number_of_steps(live_server: LiveServer, tmp_path: Path) -> None:
    page = tmp_path / "gallery.html"
    with MotionClient(live_server.address) as client:
        model = client.catalog.models[0].model_id
    assert run(["gallery", model, "--server", live_server.address, "--steps", "2,4", "--out", str(page)]) == 0
    told = json.loads(page.read_text(encoding="utf-8").partition('id="takes">')[2].partition("</script>")[0])
    assert told["columns"] == [f"{model}, 2 steps", f"{model}, 4 steps"]
    parts = {part["title"]: part["rows"] for part in told["parts"]}
    assert [len(parts[name]) for name in ("Targets", "Changes of mind")] == [len(TARGETS), len(CHANGES)]
    takes = [take for rows in parts.values() for row in rows for take in row["takes"]]
    assert all(take["num_frames"] >= 80 for take in takes)
    assert {take["verdict"] for row in parts["Targets"] for take in row["takes"]} <= {"met", "missed"}
    (goal,) = parts["Targets"][0]["takes"][0]["goals"]
    assert (goal["frame"], len(goal["points"]), goal["is_path"]) == (40, 1, False)


def test_unknown_model_is_reported(live_server: LiveServer, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run(["gallery", "other", "--server", live_server.address, "--out", str(tmp_path / "page.html")]) == 1
    assert "other" in capsys.readouterr().err
    assert not (tmp_path / "page.html").exists()
