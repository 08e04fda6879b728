"""Checks a client's events and turns them into the engine's."""

from __future__ import annotations

import math
import secrets

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.engine.types import (
    Close,
    Code,
    Event,
    Open,
    Playhead,
    PlayState,
    Seek,
    SessionKey,
    SessionSpec,
    SetConstraints,
    SetPlayState,
    SetPrompts,
    SetVelocity,
    StartPose,
)
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert.checks import (
    check_coordinates,
    check_range,
    frame_number,
    heading_of,
    identifiers_of,
    refuse,
)
from motiongen_server.rpc.convert.constraints import constraints_of
from motiongen_server.rpc.convert.forms import check_forms
from motiongen_server.rpc.convert.history import history_frames_of, prior_rows_of
from motiongen_server.rpc.convert.options import (
    asked_steps,
    coding_of,
    guidance_of,
    lookahead_of,
    priority_of,
    set_options_of,
    steps_of,
)
from motiongen_server.rpc.convert.prompts import Embeddings, prompts_of
from motiongen_server.rpc.convert.resuming import check_no_resume
from motiongen_server.rpc.convert.unserved import check_served
from motiongen_server.rpc.limits import MAX_FRAME, MAX_REQUEST_ID_CHARACTERS, MAX_SPEED_MPS

MAX_ROUND_TRIP_S = 1.0
SPEED_TOLERANCE = 1e-5
"""Relative to the greatest speed: two float32 components of exactly that speed may amount to a little more."""


def engine_event(
    event: session_pb2.SessionEvent, key: SessionKey, received_at: float, embeddings: Embeddings, catalog: Catalog
) -> Event:
    """The engine's event for any of a client's but Playhead. embeddings: one for each of `prompt_texts`.

    Raises EventRefused.
    """
    check_served(event, "")
    name = event.WhichOneof("event")
    sequence = event.event_seq
    if name == "open":
        return Open(_session_spec(event.open, key, embeddings, catalog), sequence, received_at)
    if name == "edit_prompts":
        edit = event.edit_prompts
        prompts = prompts_of(edit.upsert, "edit_prompts.upsert", embeddings, catalog)
        most = catalog.limits.max_prompts
        removed = identifiers_of(edit.remove, most, "TOO_MANY_PROMPTS", "edit_prompts.remove")
        return SetPrompts(key, sequence, received_at, prompts, removed)
    if name == "edit_constraints":
        change = event.edit_constraints
        constraints = constraints_of(change.upsert, "edit_constraints.upsert", catalog)
        most = catalog.limits.max_constraints
        removed = identifiers_of(change.remove, most, "TOO_MANY_CONSTRAINTS", "edit_constraints.remove")
        return SetConstraints(key, sequence, received_at, constraints, removed, change.clear)
    if name == "set_velocity":
        return _velocity(event.set_velocity, key, sequence, received_at, catalog)
    if name == "set_play_state":
        if int(event.set_play_state.state) not in tuple(PlayState):
            raise refuse(
                "INVALID_PLAY_STATE",
                "set_play_state.state",
                f"play state {event.set_play_state.state} does not exist",
                "PLAY_STATE_PLAYING or PLAY_STATE_PAUSED",
            )
        return SetPlayState(key, sequence, received_at, PlayState(event.set_play_state.state))
    if name == "set_options":
        return set_options_of(event.set_options, key, sequence, received_at, catalog)
    if name == "seek":
        return _seek(event.seek, key, sequence, received_at, catalog)
    if name == "close":
        return Close(key, sequence, received_at)
    raise EventRefused(
        Code.UNIMPLEMENTED,
        "UNKNOWN_EVENT",
        "this server does not know the event, or none was set",
        field="event",
        allowed="open, edit_prompts, edit_constraints, set_velocity, playhead, set_play_state, set_options, seek "
        "or close",
    )


def playhead_of(report: session_pb2.Playhead, key: SessionKey, received_at: float, rtt_s: float | None) -> Playhead:
    """The engine's event for a playhead report, which has no event number. Raises EventRefused."""
    frame, buffered_to = report.frame, report.buffered_to
    if frame > MAX_FRAME or buffered_to > MAX_FRAME:
        frame_number(frame, "playhead.frame")
        frame_number(buffered_to, "playhead.buffered_to")
    fields = (key, 0, received_at, frame, buffered_to, report.underruns, rtt_s)
    return tuple.__new__(Playhead, fields)  # faster than Playhead(...): nearly all that is read are reports


def round_trip_s(ping: service_pb2.Ping) -> float | None:
    """The client's last round trip in seconds, limited to 0 to 1; None if it has measured none."""
    if not ping.HasField("round_trip"):
        return None
    # Not with ToTimedelta, which fails for some of the Durations that a message can hold.
    return min(max(ping.round_trip.seconds + ping.round_trip.nanos / 1e9, 0.0), MAX_ROUND_TRIP_S)


def _velocity(
    message: session_pb2.SetVelocity, key: SessionKey, sequence: int, received_at: float, catalog: Catalog
) -> SetVelocity:
    for name in ("x", "z"):
        if not math.isfinite(getattr(message, name)):
            given = f"the velocity is {getattr(message, name)}"
            raise refuse("NOT_FINITE", f"set_velocity.{name}", given, "finite metres a second")
    speed = math.hypot(message.x, message.z)
    if speed > MAX_SPEED_MPS * (1 + SPEED_TOLERANCE):
        allowed = f"hypot(x, z) up to {MAX_SPEED_MPS:g} m/s"
        raise refuse("SPEED_OUT_OF_RANGE", "set_velocity", f"the speed is {speed:g} m/s", allowed)
    check_range(message.hold_frames, 1, catalog.limits.max_hold_frames, "HOLD_OUT_OF_RANGE", "set_velocity.hold_frames")
    heading = heading_of(message, "set_velocity")
    x, z, hold, keep = message.x, message.z, message.hold_frames, message.keep_prompt
    velocity = SetVelocity(key, sequence, received_at, x, z, heading, hold, keep)
    check_forms(velocity, "set_velocity", catalog)
    return velocity


def _session_spec(
    message: session_pb2.OpenSession, key: SessionKey, embeddings: Embeddings, catalog: Catalog
) -> SessionSpec:
    check_served(message, "open")
    check_no_resume(message)
    facts = catalog.facts
    if len(message.request_id) > MAX_REQUEST_ID_CHARACTERS:
        raise refuse(
            "REQUEST_ID_TOO_LONG",
            "open.request_id",
            f"the request id has {len(message.request_id)} characters",
            f"at most {MAX_REQUEST_ID_CHARACTERS} characters",
        )
    if message.rig_id not in ("", facts.rig.rig_id):
        raise refuse("UNKNOWN_RIG", "open.rig_id", f"no rig {message.rig_id[:80]!r}", facts.rig.rig_id, Code.NOT_FOUND)
    coding = coding_of(message, catalog)
    return SessionSpec(
        session=key,
        seed=message.seed if message.HasField("seed") else secrets.randbits(64),
        model_id=facts.model_id,
        priority=priority_of(message.priority, "open"),
        lookahead=lookahead_of(message.lookahead_frames, "open", catalog),
        denoise_steps=steps_of(asked_steps(message, facts), "open", catalog),
        guidance=guidance_of(message.guidance, catalog.guidance, "open"),
        start_pose=_start_pose(message.start_pose, "open"),
        prompts=prompts_of(message.prompts, "open.prompts", embeddings, catalog),
        constraints=constraints_of(message.constraints, "open.constraints", catalog),
        history_frames=history_frames_of(message, catalog.facts, "open"),
        prior_rows=prior_rows_of(message, catalog),
        gaits=catalog.gaits,
        keep_prompts=message.keep_prompts,
        outputs=tuple(block.name for block in coding.outputs),
    )


def _seek(message: session_pb2.Seek, key: SessionKey, sequence: int, received_at: float, catalog: Catalog) -> Seek:
    is_elsewhere = message.HasField("start_pose") or message.HasField("prior_frames")
    if not message.frame and not is_elsewhere:
        given, allowed = "nothing says where to seek to", "frame, start_pose or prior_frames"
        raise refuse("AMBIGUOUS_START", "seek", given, allowed)
    if message.frame and is_elsewhere:
        given, allowed = "a start pose or prior frames are given too", "one of frame, start_pose and prior_frames"
        raise refuse("AMBIGUOUS_START", "seek.frame", given, allowed)
    pose, rows = _start_pose(message.start_pose, "seek"), prior_rows_of(message, catalog, "seek")
    return Seek(key, sequence, received_at, pose, rows, frame_number(message.frame, "seek.frame"))


def _start_pose(message: session_pb2.StartPose, name: str) -> StartPose:
    check_coordinates((message.x,), f"{name}.start_pose.x")
    check_coordinates((message.z,), f"{name}.start_pose.z")
    heading = heading_of(message, f"{name}.start_pose")
    return StartPose(message.x, message.z, 0.0 if heading is None else heading)
