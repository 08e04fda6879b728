"""Protocol messages <-> engine values: pure, and the only place that checks what a client sent."""

from __future__ import annotations

import math
import secrets
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import motion_pb2, session_pb2
from server.catalog import Catalog
from server.engine.types import (
    Chunk,
    Close,
    Closed,
    Code,
    Constraint,
    Event,
    Float32Array,
    Guidance,
    JointTargets,
    Open,
    Opened,
    Outcome,
    Output,
    PlanNotice,
    Playhead,
    PlayState,
    PoseTarget,
    Priority,
    Prompt,
    RootPath,
    RootTarget,
    SessionKey,
    SessionSpec,
    SetConstraints,
    SetPlayState,
    SetPrompts,
    StartPose,
)
from server.errors import EventRefused
from server.limits import MAX_COORDINATE_M, MAX_FRAME, MAX_GUIDANCE, MAX_REQUEST_ID_CHARACTERS

UNIT_TOLERANCE = 1e-3
Embeddings = Mapping[str, NDArray[np.float32]]


def refuse(reason: str, field: str, message: str, allowed: str, code: Code = Code.INVALID_ARGUMENT) -> EventRefused:
    """The error for a field that may not be as it is."""
    return EventRefused(code, reason, message, field=field, allowed=allowed)


def prompt_texts(event: session_pb2.SessionEvent, catalog: Catalog) -> tuple[str, ...]:
    """The texts that must be encoded before `engine_event` can be called. Raises EventRefused for a bad one."""
    name = event.WhichOneof("event")
    if name == "open":
        return tuple(_text(span, f"open.prompts[{i}]", catalog) for i, span in enumerate(event.open.prompts))
    if name == "edit_prompts":
        spans = event.edit_prompts.upsert
        return tuple(_text(span, f"edit_prompts.upsert[{i}]", catalog) for i, span in enumerate(spans))
    return ()


def engine_event(
    event: session_pb2.SessionEvent, key: SessionKey, received_at: float, embeddings: Embeddings, catalog: Catalog
) -> Event:
    """The engine's event for a client's. embeddings: one for each of `prompt_texts`. Raises EventRefused."""
    name = event.WhichOneof("event")
    sequence = event.event_seq
    if name == "open":
        return Open(_session_spec(event.open, key, embeddings, catalog), sequence, received_at)
    if name == "edit_prompts":
        edit = event.edit_prompts
        prompts = _prompts(edit.upsert, "edit_prompts.upsert", embeddings, catalog)
        return SetPrompts(key, sequence, received_at, prompts, _ids(edit.remove, "edit_prompts.remove"))
    if name == "edit_constraints":
        change = event.edit_constraints
        constraints = _constraints(change.upsert, "edit_constraints.upsert", catalog)
        removed = _ids(change.remove, "edit_constraints.remove")
        return SetConstraints(key, sequence, received_at, constraints, removed, change.clear)
    if name == "playhead":
        report = event.playhead
        frame = _frame(report.frame, "playhead.frame")
        buffered = _frame(report.buffered_to, "playhead.buffered_to")
        return Playhead(key, sequence, received_at, frame, buffered, report.underruns)
    if name == "set_play_state":
        if event.set_play_state.state not in tuple(PlayState):
            raise refuse(
                "INVALID_PLAY_STATE",
                "set_play_state.state",
                f"play state {event.set_play_state.state} is not one",
                "PLAY_STATE_PLAYING or PLAY_STATE_PAUSED",
            )
        return SetPlayState(key, sequence, received_at, PlayState(event.set_play_state.state))
    if name == "close":
        return Close(key, sequence, received_at)
    raise EventRefused(
        Code.UNIMPLEMENTED,
        "UNKNOWN_EVENT",
        "this server does not know the event, or none was set",
        field="event",
        allowed="open, edit_prompts, edit_constraints, playhead, set_play_state, close",
    )


def _session_spec(
    message: session_pb2.OpenSession, key: SessionKey, embeddings: Embeddings, catalog: Catalog
) -> SessionSpec:
    facts, limits = catalog.facts, catalog.limits
    if len(message.request_id) > MAX_REQUEST_ID_CHARACTERS:
        raise refuse(
            "REQUEST_ID_TOO_LONG",
            "open.request_id",
            f"the request id has {len(message.request_id)} characters",
            f"at most {MAX_REQUEST_ID_CHARACTERS} characters",
        )
    if message.model_id not in ("", facts.model_id):
        raise refuse(
            "UNKNOWN_MODEL", "open.model_id", f"no model {message.model_id[:80]!r}", facts.model_id, Code.NOT_FOUND
        )
    if message.rig_id not in ("", facts.rig.rig_id):
        raise refuse(
            "UNKNOWN_RIG", "open.rig_id", f"no rig {message.rig_id[:80]!r}", facts.rig.rig_id, Code.NOT_FOUND
        )
    if message.priority not in (0, *Priority):
        raise refuse(
            "INVALID_PRIORITY", "open.priority", f"priority {message.priority} is not one", "HERO, NEAR, CROWD or BATCH"
        )
    if message.scalar_type not in (motion_pb2.SCALAR_TYPE_UNSPECIFIED, motion_pb2.SCALAR_TYPE_F32_LE):
        raise refuse(
            "INVALID_SCALAR_TYPE", "open.scalar_type", f"scalar type {message.scalar_type} is not offered", "F32_LE"
        )
    lookahead = message.lookahead_frames or limits.default_lookahead_frames
    _in_range(lookahead, facts.horizon, limits.max_lookahead_frames, "LOOKAHEAD_OUT_OF_RANGE", "open.lookahead_frames")
    steps = message.denoise_steps if message.HasField("denoise_steps") else facts.default_steps
    _in_range(steps, facts.min_steps, facts.max_steps, "DENOISE_STEPS_OUT_OF_RANGE", "open.denoise_steps")
    return SessionSpec(
        session=key,
        seed=message.seed if message.HasField("seed") else secrets.randbits(64),
        model_id=facts.model_id,
        priority=Priority(message.priority or Priority.NEAR),
        lookahead=lookahead,
        denoise_steps=steps,
        guidance=_guidance(message.guidance, catalog.guidance),
        start_pose=_start_pose(message.initial_root),
        prompts=_prompts(message.prompts, "open.prompts", embeddings, catalog),
        constraints=_constraints(message.constraints, "open.constraints", catalog),
    )


def _in_range(value: int, least: int, most: int, reason: str, field: str) -> None:
    if not least <= value <= most:
        raise refuse(reason, field, f"{field.rpartition('.')[2]} is {value}", f"{least} to {most}")


def _guidance(message: session_pb2.Guidance, default: Guidance) -> Guidance:
    weights = {}
    for name in ("text", "constraint"):
        weight = getattr(message, name) if message.HasField(name) else getattr(default, name)
        if not (math.isfinite(weight) and 0 <= weight <= MAX_GUIDANCE):
            raise refuse(
                "GUIDANCE_OUT_OF_RANGE", f"open.guidance.{name}", f"the weight is {weight}", f"0 to {MAX_GUIDANCE:g}"
            )
        weights[name] = float(weight)
    return Guidance(**weights)


def _start_pose(message: motion_pb2.RootPose) -> StartPose:
    _coordinates((message.x,), "open.initial_root.x")
    _coordinates((message.z,), "open.initial_root.z")
    heading = _heading(message, "open.initial_root")
    return StartPose(message.x, message.z, 0.0 if heading is None else heading)


def _text(span: motion_pb2.PromptSpan, field: str, catalog: Catalog) -> str:
    most = catalog.limits.max_prompt_characters
    allowed = f"1 to {most} characters, not all blank"
    if not span.text.strip():
        raise refuse("EMPTY_PROMPT", f"{field}.text", "the prompt is blank", f"{allowed}; remove the span for no prompt")
    if len(span.text) > most:
        raise refuse("PROMPT_TOO_LONG", f"{field}.text", f"the prompt has {len(span.text)} characters", allowed)
    return span.text


def _prompts(
    spans: Sequence[motion_pb2.PromptSpan], field: str, embeddings: Embeddings, catalog: Catalog
) -> tuple[Prompt, ...]:
    _count(spans, catalog.limits.max_prompts, "TOO_MANY_PROMPTS", field)
    prompts = []
    for index, span in enumerate(spans):
        where = f"{field}[{index}]"
        text = _text(span, where, catalog)
        start, end = _frame(span.start_frame, f"{where}.start_frame"), _frame(span.end_frame, f"{where}.end_frame")
        if end and end <= start:
            raise refuse(
                "EMPTY_SPAN", f"{where}.end_frame", f"the span ends at {end}", f"above {start}, or 0 for open-ended"
            )
        identifier = _id(span.prompt_id, f"{where}.prompt_id")
        prompts.append(Prompt(identifier, start or None, end or None, text, embeddings[text]))
    return tuple(prompts)


def _constraints(messages: Sequence[motion_pb2.Constraint], field: str, catalog: Catalog) -> tuple[Constraint, ...]:
    _count(messages, catalog.limits.max_constraints, "TOO_MANY_CONSTRAINTS", field)
    return tuple(_constraint(message, f"{field}[{index}]", catalog) for index, message in enumerate(messages))


def _constraint(message: motion_pb2.Constraint, field: str, catalog: Catalog) -> Constraint:
    identifier = _id(message.constraint_id, f"{field}.constraint_id")
    frame = _frame(message.frame, f"{field}.frame")
    target = message.WhichOneof("target")
    if target == "root":
        root = message.root
        _coordinates((root.x,), f"{field}.root.x")
        _coordinates((root.z,), f"{field}.root.z")
        return RootTarget(identifier, frame, root.x, root.z, _heading(root, f"{field}.root"))
    if target == "trajectory":
        return _trajectory(message.trajectory, identifier, frame, f"{field}.trajectory", catalog)
    if target == "joints":
        return _joint_targets(message.joints, identifier, frame, f"{field}.joints", catalog)
    if target == "pose":
        joints = len(catalog.facts.rig.joint_names)
        positions = _points(message.pose.positions, joints, 3, f"{field}.pose.positions")
        return PoseTarget(identifier, frame, positions)
    raise refuse("NO_TARGET", f"{field}.target", "no target is set", "root, joints, pose or trajectory")


def _trajectory(
    message: motion_pb2.RootTrajectory, identifier: int, frame: int, field: str, catalog: Catalog
) -> RootPath:
    most = catalog.limits.max_trajectory_frames
    count = len(message.positions) // 2
    if not 1 <= count <= most or len(message.positions) % 2:
        raise refuse(
            "WRONG_LENGTH",
            f"{field}.positions",
            f"there are {len(message.positions)} numbers",
            f"2 numbers (x, z) a frame, 1 to {most} frames",
        )
    headings = None
    if message.headings:
        headings = _numbers(message.headings, count, f"{field}.headings", "one heading a frame, or none")
        _finite(headings, f"{field}.headings", "finite radians")
    return RootPath(identifier, frame, _points(message.positions, count, 2, f"{field}.positions"), headings)


def _joint_targets(
    message: motion_pb2.JointTargets, identifier: int, frame: int, field: str, catalog: Catalog
) -> JointTargets:
    joints = tuple(message.joints)
    last = len(catalog.facts.rig.joint_names) - 1
    if any(joint > last for joint in joints) or len(set(joints)) != len(joints):
        raise refuse("INVALID_JOINTS", f"{field}.joints", f"joints {joints[:40]}", f"0 to {last}, each at most once")
    if 0 not in joints:
        raise refuse("ROOT_JOINT_MISSING", f"{field}.joints", f"joints {joints[:40]} lack the root", "0 and others")
    positions = _points(message.positions, len(joints), 3, f"{field}.positions")
    if not message.rotations:
        return JointTargets(identifier, frame, joints, positions)
    count = 4 * len(joints)
    numbers = _numbers(message.rotations, count, f"{field}.rotations", f"{count} numbers (w, x, y, z a joint), or none")
    quaternions = numbers.reshape(-1, 4)
    norms = np.linalg.norm(quaternions, axis=1)
    if not np.all(np.abs(norms - 1) <= UNIT_TOLERANCE):  # NaN fails this too
        raise refuse(
            "NOT_A_ROTATION", f"{field}.rotations", f"quaternion lengths are {norms[:8]}", "1 within 0.001, finite"
        )
    return JointTargets(identifier, frame, joints, positions, _matrices(quaternions / norms[:, None]))


def _matrices(quaternions: Float32Array) -> Float32Array:
    """(K, 4) unit quaternions w x y z -> (K, 3, 3)."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows, np.float32), -1, 0))


def _heading(message: motion_pb2.RootPose, field: str) -> float | None:
    if not message.HasField("heading"):
        return None
    if not math.isfinite(message.heading):
        raise refuse("NOT_FINITE", f"{field}.heading", f"the heading is {message.heading}", "finite radians")
    return message.heading


def _numbers(values: Sequence[float], count: int, field: str, allowed: str) -> Float32Array:
    if len(values) != count:
        raise refuse("WRONG_LENGTH", field, f"there are {len(values)} numbers", allowed)
    return np.array(values, dtype=np.float32)


def _points(values: Sequence[float], count: int, width: int, field: str) -> Float32Array:
    numbers = _numbers(values, count * width, field, f"{count * width} numbers, {width} for each of {count}")
    _coordinates(numbers, field)
    return numbers.reshape(count, width)


def _coordinates(values: Iterable[float], field: str) -> None:
    numbers = np.array(values, dtype=np.float64)
    allowed = f"finite metres within +-{MAX_COORDINATE_M:g}"
    _finite(numbers, field, allowed)
    if numbers.size and float(np.abs(numbers).max()) > MAX_COORDINATE_M:
        largest = numbers[np.abs(numbers).argmax()]
        raise refuse("COORDINATE_OUT_OF_RANGE", field, f"a coordinate is {largest:g} m", allowed)


def _finite(numbers: NDArray[np.floating], field: str, allowed: str) -> None:
    bad = numbers[~np.isfinite(numbers)]
    if bad.size:
        raise refuse("NOT_FINITE", field, f"a number is {bad.flat[0]}", allowed)


def _frame(value: int, field: str) -> int:
    if value > MAX_FRAME:
        raise refuse("FRAME_OUT_OF_RANGE", field, f"the frame is {value}", f"0 to {MAX_FRAME}")
    return value


def _id(value: int, field: str) -> int:
    if value == 0:
        raise refuse("INVALID_ID", field, "the id is 0", "1 or more")
    return value


def _ids(values: Sequence[int], field: str) -> tuple[int, ...]:
    return tuple(_id(value, f"{field}[{index}]") for index, value in enumerate(values))


def _count(values: Sequence[object], most: int, reason: str, field: str) -> None:
    if len(values) > most:
        raise refuse(reason, field, f"there are {len(values)}", f"at most {most}", Code.RESOURCE_EXHAUSTED)


def session_update(output: Output, catalog: Catalog) -> session_pb2.SessionUpdate:
    """What the client is told of one output of the engine; `applied_seq` is the stream's to fill in."""
    update = session_pb2.SessionUpdate(session=output.session.handle)
    if isinstance(output, Chunk):
        update.chunk.plan = output.plan
        update.chunk.first_frame = output.first_frame
        update.chunk.frame_count = len(output.rows)
        update.chunk.committed_to = output.committed_to
        update.chunk.data = np.ascontiguousarray(output.rows, dtype="<f4").tobytes()
        update.chunk.scalar_type = motion_pb2.SCALAR_TYPE_F32_LE
    elif isinstance(output, PlanNotice):
        update.plan.plan = output.plan
        update.plan.valid_from = output.valid_from
        update.plan.cause = session_pb2.PlanCause.ValueType(output.cause)
        update.plan.event_seqs.extend(output.event_seqs)
    elif isinstance(output, Outcome):
        update.outcome.CopyFrom(outcome_message(output))
    elif isinstance(output, Opened):
        update.opened.session_id = f"{output.session.stream}-{output.session.handle}"
        update.opened.seed = output.seed
        update.opened.start_frame = output.start_frame
        update.opened.rig_id = catalog.facts.rig.rig_id
        update.opened.model_id = catalog.facts.model_id
        update.opened.frame_rate = catalog.facts.fps
        update.opened.lookahead_frames = output.lookahead
        update.opened.committed_horizon_frames = output.committed_horizon
        update.opened.denoise_steps = output.denoise_steps
        update.opened.scalar_type = motion_pb2.SCALAR_TYPE_F32_LE
    elif isinstance(output, Closed):
        update.closed.reason = session_pb2.CloseReason.ValueType(output.reason)
        update.closed.code = output.code
        update.closed.message = output.message
        update.closed.frames = output.num_frames
        update.closed.late_frames = output.late_frames
    return update


def outcome_message(outcome: Outcome) -> session_pb2.EditOutcome:
    """The message for an engine's or the service's own outcome."""
    message = session_pb2.EditOutcome(
        event_seq=outcome.event_seq,
        code=outcome.code,
        reason=outcome.reason,
        message=outcome.message,
        field=outcome.field,
        allowed=outcome.allowed,
    )
    if outcome.effective_frame is not None:
        message.effective_frame = outcome.effective_frame
    return message
