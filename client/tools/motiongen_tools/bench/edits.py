"""Builds the events of a load: opens, edits, closes. Their content depends only on the plan and the edit's number."""

from __future__ import annotations

import math

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client import convert
from motiongen_client.motion import Rig
from motiongen_client.types import Catalog, SessionOptions
from motiongen_tools.bench.character import Character
from motiongen_tools.bench.scenario import EditRule, Group

_PROMPT_ID = 1
_TURN_PERIOD_S = 7.0  # of a stick that swings from side to side
_TURN_RAD = 1.2


def open_event(character: Character, group: Group, denoise_steps: int | None) -> session_pb2.SessionEvent:
    """Opens a character with its first prompt."""
    plan = character.plan
    options = SessionOptions(seed=plan.seed, priority=group.priority, denoise_steps=denoise_steps)
    prompt = convert.prompt_span(_PROMPT_ID, group.prompts[plan.prompt], None)
    message = convert.open_session(options, [prompt], [])
    return session_pb2.SessionEvent(session=character.handle, event_seq=character.take_seq(), open=message)


def edit_event(
    character: Character,
    group: Group,
    rule: EditRule,
    value: int,
    *,
    intended_s: float,
    now_s: float,
    catalog: Catalog,
) -> session_pb2.SessionEvent:
    """One edit. value: which prompt, or the running number of the edit under its rule."""
    event = session_pb2.SessionEvent(session=character.handle, event_seq=character.take_seq(intended_s))
    rig = catalog.rigs[0]
    match rule.kind:
        case "prompt":
            event.edit_prompts.upsert.append(convert.prompt_span(_PROMPT_ID, group.prompts[value], None))
        case "constraints":
            playhead = character.playhead(now_s) if character.started else 0
            patch = catalog.models[0].patch_frames
            first = max(playhead + rig.frames_in(rule.ahead_s), character.committed_to + patch)
            event.edit_constraints.CopyFrom(_waypoints(character.plan.seed, rule, value, first, rig))
        case "velocity":
            event.set_velocity.CopyFrom(_velocity(character.plan.seed, rule, value, rig))
    return event


def close_event(character: Character) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(
        session=character.handle, event_seq=character.take_seq(), close=session_pb2.CloseSession()
    )


def _phase_rad(seed: int) -> float:
    """The phase at which a character's stick swings; each has its own."""
    return (seed % 1009) / 1009 * 2 * math.pi


def _waypoints(seed: int, rule: EditRule, number: int, first: int, rig: Rig) -> session_pb2.EditConstraints:
    """A winding path that continues at rule.speed_m_s and replaces the previous one."""
    edit = session_pb2.EditConstraints(clear=True)
    phase = _phase_rad(seed) + number
    for index in range(rule.waypoints):
        frame = first + index * rule.spacing_frames
        along_m = rule.speed_m_s * frame / rig.frame_rate_hz
        aside_m = 0.5 * math.sin(phase + along_m / 2)
        root = motion_pb2.Waypoint(x=aside_m, z=along_m)
        edit.upsert.append(motion_pb2.Constraint(constraint_id=index + 1, frame=frame, waypoint=root))
    return edit


def _velocity(seed: int, rule: EditRule, number: int, rig: Rig) -> session_pb2.SetVelocity:
    """A stick that swings from side to side."""
    heading = _TURN_RAD * math.sin(_phase_rad(seed) + 2 * math.pi * number * rule.every_s / _TURN_PERIOD_S)
    return session_pb2.SetVelocity(
        x=rule.speed_m_s * math.sin(heading),
        z=rule.speed_m_s * math.cos(heading),
        heading=heading,
        hold_frames=max(1, rig.frames_in(rule.hold_s)),
    )
