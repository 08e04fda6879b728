"""SetOptions and Seek from the wire, and what changed options cost of a peer's limits."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import (
    Code,
    EventRefused,
    Guidance,
    Priority,
    Seek,
    SessionKey,
    SetOptions,
    StartPose,
)
from motiongen_server.rpc.budgets.peers import PeerLimits, Peers
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import engine_event
from motiongen_server.rpc.limits import Limits
from tests.server.engine.fakes import FACTS

KEY = SessionKey(3, 9)
CATALOG = Catalog(FACTS, Limits(), Guidance(1.5, 2.5), "CC0-1.0", text_encoder="hashed-1", history_frames=16)


def asked(options: session_pb2.SetOptions) -> SetOptions:
    event = engine_event(session_pb2.SessionEvent(event_seq=2, set_options=options), KEY, 1.0, {}, CATALOG)
    assert isinstance(event, SetOptions)
    return event


def test_absent_options_stay_unset() -> None:
    assert asked(session_pb2.SetOptions()) == SetOptions(KEY, 2, 1.0)


def test_every_option_arrives_and_an_absent_weight_gets_its_default() -> None:
    message = session_pb2.SetOptions(priority=1, lookahead_frames=60, denoise_steps=5, history_frames=8)
    message.guidance.text = 3.0
    assert asked(message) == SetOptions(KEY, 2, 1.0, Priority.HERO, 60, 5, Guidance(3.0, 2.5), 8)


@pytest.mark.parametrize(
    ("options", "reason", "field"),
    [
        (session_pb2.SetOptions(priority=9), "INVALID_PRIORITY", "priority"),  # type: ignore[arg-type]
        (session_pb2.SetOptions(lookahead_frames=3), "LOOKAHEAD_OUT_OF_RANGE", "lookahead_frames"),
        (session_pb2.SetOptions(denoise_steps=99), "DENOISE_STEPS_OUT_OF_RANGE", "denoise_steps"),
        (session_pb2.SetOptions(guidance=session_pb2.Guidance(text=-1)), "GUIDANCE_OUT_OF_RANGE", "guidance.text"),
        (session_pb2.SetOptions(history_frames=3), "HISTORY_OUT_OF_RANGE", "history_frames"),
    ],
)
def test_invalid_options_are_refused_with_reason_and_field(
    options: session_pb2.SetOptions, reason: str, field: str
) -> None:
    with pytest.raises(EventRefused) as refused:
        asked(options)
    assert (refused.value.reason, refused.value.field) == (reason, f"set_options.{field}")


def sought(message: session_pb2.Seek) -> Seek:
    event = engine_event(session_pb2.SessionEvent(event_seq=2, seek=message), KEY, 1.0, {}, CATALOG)
    assert isinstance(event, Seek)
    return event


def test_seek_carries_a_start_pose_or_prior_frames_or_a_frame() -> None:
    pose = session_pb2.StartPose(x=1, z=2, heading=0.5)
    assert sought(session_pb2.Seek(start_pose=pose)).start_pose == StartPose(1.0, 2.0, 0.5)
    row = np.zeros((4, 12), "<f4")
    row[:, 3] = 1.0
    frames = motion_pb2.FrameChunk(frame_count=4, data=row.tobytes())
    rows = sought(session_pb2.Seek(prior_frames=frames)).prior_rows
    assert rows is not None
    assert rows.shape == (4, 12)
    back = sought(session_pb2.Seek(frame=40))
    assert (back.frame, back.prior_rows) == (40, None)


@pytest.mark.parametrize(
    ("message", "reason", "field"),
    [
        (session_pb2.Seek(), "AMBIGUOUS_START", "seek"),
        (session_pb2.Seek(frame=9, start_pose=session_pb2.StartPose()), "AMBIGUOUS_START", "seek.frame"),
        (session_pb2.Seek(frame=2**53 + 1), "FRAME_OUT_OF_RANGE", "seek.frame"),
        (session_pb2.Seek(start_pose=session_pb2.StartPose(x=1e9)), "COORDINATE_OUT_OF_RANGE", "seek.start_pose.x"),
        (
            session_pb2.Seek(start_pose=session_pb2.StartPose(), prior_frames=motion_pb2.FrameChunk(frame_count=4)),
            "AMBIGUOUS_START",
            "seek.start_pose",
        ),
        (
            session_pb2.Seek(prior_frames=motion_pb2.FrameChunk(frame_count=3)),
            "PRIOR_FRAMES_OUT_OF_RANGE",
            "seek.prior_frames.frame_count",
        ),
    ],
)
def test_invalid_seek_is_refused_with_reason_and_field(message: session_pb2.Seek, reason: str, field: str) -> None:
    with pytest.raises(EventRefused) as refused:
        sought(message)
    assert (refused.value.reason, refused.value.field) == (reason, field)


def test_change_of_class_is_counted_and_undone_if_the_engine_refuses_it() -> None:
    peer = Peers(PeerLimits(heroes=1)).find("ipv4:10.0.0.1:5", 0.0)
    first, second = peer.place(Priority.NEAR, 0.0), peer.place(Priority.NEAR, 0.0)
    weight = peer.session_weight
    settle = first.change(Priority.HERO, 40.0)
    with pytest.raises(EventRefused) as refused:
        second.change(Priority.HERO, None)
    assert (refused.value.code, refused.value.field) == (Code.RESOURCE_EXHAUSTED, "set_options.priority")
    settle(False)
    assert peer.session_weight == weight
    second.change(Priority.HERO, 40.0)
    first.release()
    second.release()
    assert peer.num_sessions == peer.session_weight == 0
    assert peer.is_idle(1e6)


def test_refused_options_are_uncounted_despite_later_changes() -> None:
    peer = Peers(PeerLimits(heroes=1)).find("ipv4:10.0.0.1:5", 0.0)
    place = peer.place(Priority.NEAR, 0.0)
    weight = peer.session_weight
    first, second = place.change(Priority.HERO, 40.0), place.change(None, 80.0)
    third = place.change(Priority.HERO, 90.0)
    first(False)
    second(True)
    third(False)
    assert peer.session_weight == weight
    peer.place(Priority.HERO, 0.0).release()
    place.release()
    assert peer.session_weight == 0


def test_reduced_quota_refuses_only_changes_that_ask_for_more() -> None:
    peer = Peers(PeerLimits()).find("ipv4:10.0.0.1:5", 0.0)
    places = [peer.place(Priority.NEAR, 0.0) for _ in range(3)]
    peer.adopt(PeerLimits(session_weight=4), 0.0)
    places[0].change(None, None)
    places[0].change(Priority.CROWD, None)
    with pytest.raises(EventRefused) as refused:
        places[1].change(Priority.HERO, None)
    assert (refused.value.reason, refused.value.field) == ("PEER_SESSION_LIMIT", "set_options.priority")


def test_steps_beyond_the_quota_are_refused_naming_denoise_steps() -> None:
    peer = Peers(PeerLimits(steps_per_second=10.0)).find("ipv4:10.0.0.1:5", 0.0)
    with pytest.raises(EventRefused) as refused:
        peer.place(Priority.NEAR, 0.0).change(None, 20.0)
    assert (refused.value.reason, refused.value.field) == ("STEPS_QUOTA", "set_options.denoise_steps")
