"""Every kind of edit, sent by the C++ client to a real server."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from tests.conftest import LiveServer
from tests.cpp.building import ROOT
from tests.cpp.test_client import Character, character

Program = Callable[[str], Path]
UP = "1,0,0,0"


def answer(walker: Character, line: str) -> list[str]:
    walker.tell(line)
    return walker.hear("edit")[2:]


FORMS = [
    "target waypoint frame=60 x=0 z=1 heading=0.5 metres=0.2 radians=0.3",
    "target waypoint frame=60 last=90 x=0 z=1 weight=0.5",
    "target waypoint frame=40 x=0 z=1 effect=1 relative=1",
    "target trajectory frame=60 positions=0,1,0,1.05,0,1.1 headings=0,0,0.1",
    "target path positions=0,2,1,3 speed=1.5 smoothing=0.2",
    "target heading frame=60 heading=1",
    f"target rotations frame=60 joints=5 rotations={UP}",
    f"target joints frame=60 joints=0,5 positions=0,1,1,0,1.5,1 rotations=0,0,0,0,{UP}",
    "target joints frame=60 joints=0 positions=0,0.9,1",
    "target foot frame=60 limb=LeftFoot x=0.1 z=1 heading=0.2",
    "go 2 5 heading=1",
    "go 0 2 relative=1",
]


@pytest.mark.parametrize("line", FORMS)
def test_target_of_every_form_is_accepted(program: Program, live_server: LiveServer, line: str) -> None:
    with character(program, live_server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 10")
        walker.hear("frame")
        assert answer(walker, line)[0] == "OK"


def test_placement_of_a_target_is_reported(program: Program, live_server: LiveServer) -> None:
    with character(program, live_server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 10")
        walker.hear("frame")
        walker.tell("go 1 3")
        assert walker.hear("edit")[2] == "OK"
        _, target, first, last, arrival, anchor = walker.hear("placed")
        assert target == "1"
        assert int(anchor) <= int(first) <= int(arrival) <= int(last)


def test_outcome_is_of_the_replacement_target_and_unknown_ids_are_refused(
    program: Program, live_server: LiveServer
) -> None:
    with character(program, live_server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 10")
        walker.hear("frame")
        assert answer(walker, "target waypoint frame=70 x=5 z=5")[0] == "OK"
        assert answer(walker, "replace_target id=1 waypoint frame=60 x=0 z=1 metres=1000")[0] == "OK"
        for frame in range(0, 71):
            walker.tell(f"wait {frame}")
            assert walker.hear("frame")[2] == "OK"
            walker.tell(f"to {frame}")
        told = [words for words in walker.heard if words[0] == "reached"] or [walker.hear("reached")]
        assert [words[1:4] for words in told] == [["1", "1", "60"]]
        walker.tell("replace_target id=9 waypoint frame=60 x=0 z=1")
        assert "an id that an earlier call gave" in " ".join(walker.hear("refused"))


def test_prompts_can_be_scheduled_moved_and_removed(program: Program, live_server: LiveServer) -> None:
    with character(program, live_server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 10")
        walker.hear("frame")
        assert answer(walker, "schedule 60 90 a person waves")[:2] == ["OK", "60"]
        assert answer(walker, "replace_prompt 2 70 100 a person jumps")[0] == "OK"
        assert answer(walker, "remove_prompt 2")[0] == "OK"
        assert answer(walker, "remove_prompt 2")[0] == "UNKNOWN_PROMPT"
        assert answer(walker, "replace_prompt 1 80 0 a person jumps")[:2] == ["OK", "80"], "the prompt in force"
        walker.tell("replace_prompt 9 60 90 a person waves")
        assert "an id that an earlier call gave" in " ".join(walker.hear("refused"))
        walker.tell("schedule 90 60 a person waves")
        assert "above start_frame" in " ".join(walker.hear("refused"))


def test_prompt_that_has_begun_is_removed_once_by_prompts_in_quick_succession(
    program: Program, live_server: LiveServer
) -> None:
    with character(program, live_server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 30")
        walker.hear("frame")
        assert answer(walker, "schedule 10 0 a person waves")[0] == "OK"
        walker.tell("to 30")
        for text in ("a person runs", "a person jumps"):
            walker.tell(f"prompt {text}")
        assert walker.hear("edit")[2] == "OK"
        assert walker.hear("edit")[2] == "OK", "it does not remove again what the first has removed"


def test_options_of_an_open_session_can_be_changed(program: Program, live_server: LiveServer) -> None:
    with character(program, live_server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 10")
        walker.hear("frame")
        assert answer(walker, "options priority=1 steps=2 guidance=2.5")[0] == "OK"
        assert answer(walker, "options steps=100000")[0] == "DENOISE_STEPS_OUT_OF_RANGE"


def test_teleport_moves_the_character_at_its_effective_frame(program: Program, live_server: LiveServer) -> None:
    with character(program, live_server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 10")
        walker.hear("frame")
        walker.tell("to 4")
        _, _, code, effective = (walker.tell("teleport 20 30 heading=1.5"), *walker.hear("edit"))[-4:]
        assert code == "OK"
        frame = int(effective)
        walker.tell(f"wait {frame}")
        walker.hear("frame")
        x, _, z = walker.place(frame)
        assert abs(x - 20) < 2
        assert abs(z - 30) < 2
        x, _, z = walker.place(frame - 1)
        assert abs(x) < 5, "decided frames stay"


def test_seek_returns_to_an_earlier_frame_under_a_later_number(program: Program, live_server: LiveServer) -> None:
    with character(program, live_server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 20")
        walker.hear("frame")
        walker.tell("to 16")
        code, effective = answer(walker, "seek 12")[:2]
        assert code == "OK"
        assert int(effective) > 16, "frame numbers continue"
        walker.tell(f"wait {effective}")
        assert walker.hear("frame")[2] == "OK"
        assert answer(walker, "seek 100000")[0] == "FRAME_NOT_HELD"
        walker.tell("seek 0")
        assert "a frame from 1 on" in " ".join(walker.hear("refused"))


@pytest.mark.parametrize(("number", "metres"), [("2", 0.0015), ("3", 0.001)])
def test_compressed_frame_formats_equal_float_frames_within_tolerance(
    program: Program, live_server: LiveServer, number: str, metres: float
) -> None:
    rows = []
    for frame_format in ("1", number):
        variables = {"MOTIONGEN_CLOCK": "manual", "MOTIONGEN_FORMAT": frame_format}
        with character(program, live_server.address, **variables) as walker:
            walker.tell("wait 20")
            walker.hear("frame")
            walker.tell("row 20")
            rows.append([float(word) for word in walker.hear("row")[2:]])
    exact, stored = rows
    assert len(exact) == len(stored) > 100
    assert max(abs(a - b) for a, b in zip(exact[:3], stored[:3], strict=True)) < metres
    turns = [np.array(row[3:-4]).reshape(-1, 4) for row in (exact, stored)]
    assert np.abs(np.abs((turns[0] * turns[1]).sum(axis=1)) - 1).max() < 1e-4  # q and -q are the same rotation
    assert exact[-4:] == stored[-4:]


NOT_SENT = {
    "SessionEvent": {"take_snapshot"},
    "OpenSession": {"request_id", "snapshot"},
    "Seek": set(),
    "Constraint": set(),
    "PromptSpan": set(),
    "SetOptions": set(),
    "SetVelocity": set(),
    "RootPath": set(),
}
"""Fields that the C++ client does not send; client/cpp/README.md says why."""


NOT_READ = {
    "ServerHello": {"server_time_ns"},
    "Pong": {"server_time_ns"},
    "SessionUpdate": {"snapshot", "durable_seq"},
    "PlanNotice": {"event_seqs", "cause"},  # the cause is read by its number
    "EditOutcome": {"spare_sessions"},
    "SessionClosed": {"late_frames"},
    "Goodbye": {"grace"},
}
"""Fields of a server's messages that it does not read; the same page says why."""

READ = (
    "GetCatalogResponse", "Model", "Limits", "ConstraintForm", "LocomotionPreset", "Preset", "Rig", "Limb",
    "GenerateClipResponse", "ClipSummary", "ConstraintResidual", "Deviation", "SessionOpened",
    "ConstraintPlacement", "EventWarning", "ConstraintReached", "SessionDurability", "ServiceLevel", "FrameChunk",
    *NOT_READ,
)  # fmt: skip


def test_every_field_set_by_servers_is_read_or_listed_as_not_read() -> None:
    folder = ROOT / "client" / "cpp" / "src" / "client"
    words = {word for path in folder.glob("*.[ch]pp") for word in re.findall(r"\w+", path.read_text(encoding="utf-8"))}
    for name in READ:
        (module,) = (each for each in (motion_pb2, service_pb2, session_pb2) if hasattr(each, name))
        fields = set(getattr(module, name).DESCRIPTOR.fields_by_name)
        left_out = NOT_READ.get(name, set())
        assert left_out <= fields
        assert not fields - left_out - words, name


def test_every_field_clients_may_set_is_set_or_listed_as_not_set() -> None:
    sources = "".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "client" / "cpp" / "src" / "client").glob("*.cpp")
    )
    for name, left_out in NOT_SENT.items():
        module = motion_pb2 if hasattr(motion_pb2, name) else session_pb2
        fields = set(getattr(module, name).DESCRIPTOR.fields_by_name)
        assert left_out <= fields
        missing = {
            field
            for field in fields - left_out
            if not any(f"{verb}_{field}(" in sources for verb in ("set", "mutable", "add", "put", "has"))
        }
        assert not missing, f"{name}: {missing}"
