"""Files that people write by hand are UTF-8, and may begin with a byte order mark, which some editors write."""

from __future__ import annotations

import codecs
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from motiongen_ardy.checkpoint.files import read_yaml
from motiongen_ardy.checkpoint.model_card import read_model_card
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.data.labels import read_labels
from motiongen_ardy.formats.constraints import read_constraints as read_library_constraints
from motiongen_ardy.text.__main__ import read_lines
from motiongen_ardy.train.prompt_domain import read_prompts
from motiongen_client.retarget import read_joint_map
from motiongen_compliance.reach import token_of
from motiongen_server.identity.tenants import read_tenants
from motiongen_server.text.encoder.access import _read_token
from motiongen_tools.bench.scenario import load_scenario
from motiongen_tools.connection import read_token
from motiongen_tools.constraint_file import read_constraints
from motiongen_tools.view.session_file import FORMAT, read_session
from tests.client.bodies import client_rig
from tests.conftest import ROOT

SCENARIOS = ROOT / "client" / "tools" / "motiongen_tools" / "bench" / "scenarios"
MAP = {
    "metres_per_unit": 1.0,
    "joints": {"Hips": {"from": "pelvis", "axes": ["left", "up", "forward"]}},
    "root": {"from": ["pelvis"], "to": ["Hips"], "scale": 1.0, "ground": {"source_height": 0.0, "height": 0.0}},
}
SESSION = {"format": FORMAT, "opening": {}, "num_frames": 3, "edits": []}
WAYPOINT = '[{"type": "root2d", "frame_indices": [3], "root_2d": [[1, 2]]}]'
TENANT = '[tenants.studio]\ntokens = [{ hash = "sha256:' + "0" * 12 + ":" + "1" * 32 + ":" + "2" * 64 + '" }]\n'


def shown(read: Callable[[Path], object]) -> Callable[[Path], str]:
    return lambda path: repr(read(path))


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("map.json", json.dumps(MAP), shown(lambda path: list(read_joint_map(path).drives))),
        ("crowd.yaml", (SCENARIOS / "crowd.yaml").read_text(), shown(lambda path: load_scenario(str(path)).groups)),
        ("targets.json", WAYPOINT, shown(lambda path: read_constraints(path, client_rig(), 20, 100))),
        ("list.json", WAYPOINT, shown(lambda path: read_library_constraints(path, load_skeleton("core27")))),
        ("a.session.json", json.dumps(SESSION), shown(read_session)),
        ("token", "secret\n", shown(read_token)),
        ("token", "secret\n", shown(token_of)),
        ("token", "secret\n", shown(_read_token)),
        ("tenants.toml", TENANT, shown(lambda path: type(read_tenants(str(path))))),
        ("prompts.txt", "a person walks\n", shown(read_lines)),
        ("inside.txt", "a person walks\n", shown(read_prompts)),
        ("sampling.yaml", "steps: 4\n", shown(read_yaml)),
        ("MODEL_CARD.md", "---\nlicense: mit\n---\n", shown(lambda path: read_model_card(path.parent).licence)),
        ("labels.csv", (ROOT / "ardy/motiongen_ardy/data/more_labels.csv").read_text(), shown(read_labels)),
    ],
)
def test_a_byte_order_mark_changes_nothing(name: str, text: str, read: Callable[[Path], str], tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    without = read(tmp_path / name)
    (tmp_path / name).write_bytes(codecs.BOM_UTF8 + text.encode())
    assert read(tmp_path / name) == without
