"""Between the contract's messages and this package's types. Pure; the one file that knows both."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from google.protobuf.duration_pb2 import Duration

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_client.errors import EventRefused, ProtocolViolation
from motiongen_client.motion import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK, Float32, Rig
from motiongen_client.prompts import Preset, Prompt, TextEmbedding
from motiongen_client.types import (
    Catalog,
    Constraint,
    ConstraintReached,
    Deviation,
    Flexible,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Limits,
    LocomotionPreset,
    Model,
    ModelWarning,
    Opened,
    Outcome,
    Placement,
    Priority,
    Residual,
    RootPath,
    RootTrajectory,
    ServiceLevel,
    SessionEnd,
    SessionOptions,
    StartPose,
    Waypoint,
)

_PRIORITIES = {
    Priority.HERO: session_pb2.PRIORITY_CLASS_HERO,
    Priority.NEAR: session_pb2.PRIORITY_CLASS_NEAR,
    Priority.CROWD: session_pb2.PRIORITY_CLASS_CROWD,
    Priority.BATCH: session_pb2.PRIORITY_CLASS_BATCH,
}

# google.rpc.Code, which EditOutcome.code and SessionClosed.code are numbers of
_CODE_NAMES = (
    "OK", "CANCELLED", "UNKNOWN", "INVALID_ARGUMENT", "DEADLINE_EXCEEDED", "NOT_FOUND", "ALREADY_EXISTS",
    "PERMISSION_DENIED", "RESOURCE_EXHAUSTED", "FAILED_PRECONDITION", "ABORTED", "OUT_OF_RANGE", "UNIMPLEMENTED",
    "INTERNAL", "UNAVAILABLE", "DATA_LOSS", "UNAUTHENTICATED",
)  # fmt: skip


# ---- to the server


def open_session(
    options: SessionOptions, prompts: Iterable[motion_pb2.PromptSpan], constraints: Iterable[motion_pb2.Constraint]
) -> session_pb2.OpenSession:
    """The message that opens a session with these options."""
    message = session_pb2.OpenSession(
        rig_id=options.rig_id,
        model_id=options.model_id,
        seed=options.seed,
        priority=_PRIORITIES[options.priority],
        lookahead_frames=options.lookahead_frames or 0,
        scalar_type=motion_pb2.SCALAR_TYPE_F32_LE,
        prompts=prompts,
        constraints=constraints,
        denoise_steps=options.denoise_steps,
        history_frames=options.history_frames,
        keep_prompts=options.keep_prompts,
    )
    if options.prior is not None:
        message.prior_frames.frame_count = len(options.prior)
        message.prior_frames.scalar_type = motion_pb2.SCALAR_TYPE_F32_LE
        message.prior_frames.data = np.ascontiguousarray(options.prior.rows, "<f4").tobytes()
    if options.start != StartPose():
        message.start_pose.CopyFrom(
            session_pb2.StartPose(x=options.start.x_m, z=options.start.z_m, heading=options.start.heading_rad)
        )
    if options.text_guidance is not None or options.constraint_guidance is not None:
        message.guidance.CopyFrom(
            session_pb2.Guidance(text=options.text_guidance, constraint=options.constraint_guidance)
        )
    return message


def generate_clip(
    opening: session_pb2.OpenSession, num_frames: int, num_samples: int
) -> service_pb2.GenerateClipRequest:
    """The message that asks for a clip."""
    opening.priority = session_pb2.PRIORITY_CLASS_UNSPECIFIED  # a clip has none
    return service_pb2.GenerateClipRequest(open=opening, frame_count=num_frames, sample_count=num_samples)


def prompt_span(
    prompt_id: int, prompt: Prompt, start_frame: int | None, end_frame: int | None = None
) -> motion_pb2.PromptSpan:
    """A prompt that holds from a frame on, or as soon as possible, and up to another frame or to the end."""
    span = motion_pb2.PromptSpan(prompt_id=prompt_id, start_frame=start_frame or 0, end_frame=end_frame or 0)
    match prompt:
        case Preset():
            span.preset_id = prompt.preset_id
        case TextEmbedding():
            span.text = prompt.text
            span.embedding.text_encoder = prompt.text_encoder
            span.embedding.values.extend(np.asarray(prompt.values, np.float32).tolist())
        case _:
            span.text = prompt
    return span


def constraint(constraint_id: int, asked: Constraint) -> motion_pb2.Constraint:
    """A constraint with the id that replaces or removes it later."""
    target = asked.target if isinstance(asked, Flexible) else asked
    message = motion_pb2.Constraint(
        constraint_id=constraint_id, tolerance_m=target.tolerance_m, tolerance_rad=target.tolerance_rad
    )
    if isinstance(asked, Flexible):
        message.at_any_frame, message.frames_from_effect = asked.at_any_frame, asked.frames_from_effect
        message.relative_to_character = asked.is_relative
        if asked.last_frame is not None:
            message.last_frame = asked.last_frame
        if asked.weight is not None:
            message.weight = asked.weight
    if not isinstance(target, RootPath):
        message.frame = target.first_frame if isinstance(target, RootTrajectory) else target.frame
    match target:
        case Waypoint():
            message.waypoint.CopyFrom(motion_pb2.Waypoint(x=target.x_m, z=target.z_m, heading=target.heading_rad))
        case RootTrajectory():
            message.root_trajectory.positions.extend(target.positions_m.ravel().tolist())
            if target.headings_rad is not None:
                message.root_trajectory.headings.extend(target.headings_rad.tolist())
        case RootPath():
            path = motion_pb2.RootPath(speed_mps=target.speed_mps, smoothing_m=target.smoothing_m)
            path.positions.extend(target.corners_m.ravel().tolist())
            message.root_path.CopyFrom(path)
        case Keyframe():
            message.keyframe.positions.extend(target.positions_m.ravel().tolist())
        case HeadingTarget():
            message.heading.CopyFrom(motion_pb2.HeadingTarget(heading=target.heading_rad))  # a heading of 0 too
        case JointRotations():
            message.joint_rotations.joints.extend(target.joints)
            message.joint_rotations.rotations.extend(target.rotations_quat_wxyz.ravel().tolist())
        case JointTargets():
            message.joint_targets.joints.extend(target.joints)
            message.joint_targets.positions.extend(target.positions_m.ravel().tolist())
            if target.rotations_quat_wxyz is not None:
                message.joint_targets.rotations.extend(target.rotations_quat_wxyz.ravel().tolist())
    return message


# ---- from the server


def catalog(message: service_pb2.GetCatalogResponse) -> Catalog:
    """The catalogue. Raises ProtocolViolation when a rig contradicts itself."""
    limits = message.limits
    return Catalog(
        etag=message.catalog_etag,
        rigs=tuple(rig(entry) for entry in message.rigs),
        models=tuple(
            Model(
                model_id=entry.model_id,
                rig_id=entry.rig_id,
                licence=entry.licence,
                horizon_frames=entry.horizon_frames,
                patch_frames=entry.patch_frames,
                future_frames=entry.future_frames,
                default_denoise_steps=entry.default_denoise_steps,
                min_denoise_steps=entry.min_denoise_steps,
                max_denoise_steps=entry.max_denoise_steps,
                text_encoder=entry.text_encoder,
                text_width=entry.text_width,
                presets={preset.preset_id: preset.text for preset in entry.presets},
                num_parameters=entry.num_parameters,
                default_history_frames=entry.default_history_frames,
                max_history_frames=entry.max_history_frames,
                preset_descriptions={each.preset_id: each.description for each in entry.presets if each.description},
                constraint_forms={each.form: _support_name(each.support) for each in entry.constraint_forms},
                locomotion_presets=tuple(
                    LocomotionPreset(each.name, each.text, each.from_speed_mps, each.direction)
                    for each in entry.locomotion_presets
                ),
                known_motions=tuple(entry.known_motions),
                default_tolerance_m=entry.default_tolerance_m,
                default_tolerance_rad=entry.default_tolerance_rad,
            )
            for entry in message.models
        ),
        limits=Limits(
            max_sessions_per_stream=limits.max_sessions_per_stream,
            max_constraints=limits.max_constraints,
            max_prompts=limits.max_prompts,
            max_prompt_characters=limits.max_prompt_characters,
            max_trajectory_frames=limits.max_trajectory_frames,
            max_request_bytes=limits.max_request_bytes,
            default_lookahead_frames=limits.default_lookahead_frames,
            max_lookahead_frames=limits.max_lookahead_frames,
            max_coordinate_m=limits.max_coordinate_m,
            max_guidance=limits.max_guidance,
            max_events_per_second=limits.max_events_per_second,
            max_stream_events_per_second=limits.max_stream_events_per_second,
            max_speed_mps=limits.max_speed_mps,
            max_hold_frames=limits.max_hold_frames,
            max_clip_frames=limits.max_clip_frames,
            max_clip_samples=limits.max_clip_samples,
        ),
    )


def rig(message: motion_pb2.Rig) -> Rig:
    """A rig. Raises ProtocolViolation when its counts do not fit together or a block this package reads is missing."""
    num_joints = len(message.joints)
    blocks = {block.name: block.width for block in message.blocks}
    widths = {ROOT_BLOCK: 3, ROTATION_BLOCK: 4 * num_joints, CONTACT_BLOCK: 4}
    for name, width in widths.items():
        if blocks.get(name) != width:
            raise ProtocolViolation(f"rig {message.rig_id}: block {name} has width {blocks.get(name)}, not {width}")
    if len(message.parents) != num_joints or len(message.neutral_offsets_m) != 3 * num_joints:
        raise ProtocolViolation(
            f"rig {message.rig_id}: {num_joints} joints, but {len(message.parents)} parents and "
            f"{len(message.neutral_offsets_m)} offset numbers"
        )
    if any(not -1 <= parent < joint or (parent < 0) != (joint == 0) for joint, parent in enumerate(message.parents)):
        raise ProtocolViolation(f"rig {message.rig_id}: parents {list(message.parents)} are no tree, parents first")
    named = [*message.hip_joints, *(joint for limb in message.limbs for joint in limb.joints)]
    if any(joint >= num_joints for joint in named) or len(message.hip_joints) not in (0, 2):
        raise ProtocolViolation(f"rig {message.rig_id}: its hips or limbs are no joints of {num_joints}: {named}")
    hips = (message.hip_joints[0], message.hip_joints[1]) if message.hip_joints else None
    if message.frame_rate < 1:
        raise ProtocolViolation(f"rig {message.rig_id}: frame rate {message.frame_rate}")
    return Rig(
        rig_id=message.rig_id,
        joint_names=tuple(message.joints),
        parents=tuple(message.parents),
        offsets_m=np.array(message.neutral_offsets_m, dtype=np.float32).reshape(num_joints, 3),
        frame_rate_hz=message.frame_rate,
        blocks=blocks,
        hip_joints=hips,
        limbs={limb.name: tuple(limb.joints) for limb in message.limbs},
    )


def chunk_rows(message: motion_pb2.FrameChunk, row_width: int) -> Float32:
    """(T, row_width) float32, read-only. Raises ProtocolViolation when the bytes are not that many rows."""
    if message.scalar_type != motion_pb2.SCALAR_TYPE_F32_LE:
        raise ProtocolViolation(f"a chunk has scalar type {message.scalar_type}; F32_LE was asked for")
    expected = message.frame_count * row_width * 4
    if message.frame_count < 1 or len(message.data) != expected:
        raise ProtocolViolation(
            f"a chunk of {message.frame_count} frames has {len(message.data)} bytes, not the {expected} of its rig"
        )
    rows = np.frombuffer(message.data, dtype="<f4").reshape(message.frame_count, row_width)
    return rows.astype(np.float32, copy=False)


def opened(message: session_pb2.SessionOpened) -> Opened:
    return Opened(
        session_id=message.session_id,
        seed=message.seed,
        start_frame=message.start_frame,
        rig_id=message.rig_id,
        model_id=message.model_id,
        frame_rate_hz=message.frame_rate,
        lookahead_frames=message.lookahead_frames,
        committed_horizon_frames=message.committed_horizon_frames,
        denoise_steps=message.denoise_steps,
        warnings=warnings(message.warnings),
        placements=placements(message.placements),
    )


def placements(messages: Iterable[motion_pb2.ConstraintPlacement], offset: int = 0) -> tuple[Placement, ...]:
    """Where constraints were put. offset: of the client's frame numbers over the server's."""
    return tuple(
        Placement(
            constraint_id=each.constraint_id,
            first_frame=each.first_frame + offset,
            last_frame=each.last_frame + offset,
            arrival_frame=each.arrival_frame + offset,
            anchor_frame=each.anchor_frame + offset,
            anchor_x_m=each.anchor_x,
            anchor_z_m=each.anchor_z,
            anchor_heading_rad=each.anchor_heading,
        )
        for each in messages
    )


def warnings(messages: Iterable[session_pb2.EventWarning]) -> tuple[ModelWarning, ...]:
    return tuple(ModelWarning(each.reason, each.message, each.field) for each in messages)


def outcome(message: session_pb2.EditOutcome, event: str, offset: int = 0) -> Outcome | EventRefused:
    """What became of an event; `event` says in words what it was, `offset` which of our frames is the server's 0."""
    if message.code == 0:
        effective_frame = message.effective_frame + offset if message.HasField("effective_frame") else None
        placed = placements(message.placements, offset)
        return Outcome(message.event_seq, effective_frame, warnings(message.warnings), placed)
    retry_after_s = seconds(message.retry_after) if message.HasField("retry_after") else None
    code = code_name(message.code)
    return EventRefused(event, code, message.reason, message.message, message.field, message.allowed, retry_after_s)


def service_level(message: session_pb2.ServiceLevel) -> ServiceLevel:
    tier = session_pb2.ServiceTier.Name(message.tier) if message.tier in _SERVICE_TIERS else "UNSPECIFIED"
    return ServiceLevel(tier.removeprefix("SERVICE_TIER_").lower(), message.denoise_steps)


def constraint_reached(message: session_pb2.ConstraintReached, offset: int = 0) -> ConstraintReached:
    """What became of a constraint. offset: of the client's frame numbers over the server's."""
    return ConstraintReached(
        constraint_id=message.constraint_id,
        met=message.met,
        frame=message.frame + offset,
        position_error_m=message.position_error_m if message.HasField("position_error_m") else None,
        rotation_error_rad=message.rotation_error_rad if message.HasField("rotation_error_rad") else None,
    )


def residual(message: service_pb2.ConstraintResidual) -> Residual:
    """How near a clip came to a constraint."""

    def deviation(name: str) -> Deviation | None:
        value: service_pb2.Deviation = getattr(message, name)
        return Deviation(value.mean, value.worst) if message.HasField(name) else None

    return Residual(
        num_frames=message.frame_count,
        position_m=deviation("position_m"),
        heading_rad=deviation("heading_rad"),
        rotation_rad=deviation("rotation_rad"),
        met=message.met,
    )


def session_end(message: session_pb2.SessionClosed) -> SessionEnd:
    reason = session_pb2.CloseReason.Name(message.reason) if message.reason in _CLOSE_REASONS else "UNSPECIFIED"
    return SessionEnd(
        reason=reason.removeprefix("CLOSE_REASON_").lower(),
        message=message.message,
        frames=message.frames,
        late_frames=message.late_frames,
    )


def ping(now_ns: int, round_trip_s: float | None) -> service_pb2.Ping:
    """round_trip_s: of the last one, None before there was one."""
    message = service_pb2.Ping(client_time_ns=now_ns)
    if round_trip_s is not None:
        message.round_trip.FromNanoseconds(round(1e9 * round_trip_s))
    return message


def seconds(duration: Duration) -> float:
    return duration.seconds + duration.nanos / 1e9


def _support_name(support: int) -> str:
    name = service_pb2.FormSupport.Name(support) if support in _FORM_SUPPORTS else "UNSPECIFIED"
    return name.removeprefix("FORM_SUPPORT_").lower()


_FORM_SUPPORTS = frozenset(service_pb2.FormSupport.values())
_CLOSE_REASONS = frozenset(session_pb2.CloseReason.values())
_SERVICE_TIERS = frozenset(session_pb2.ServiceTier.values())


def code_name(code: int) -> str:
    """Name of a google.rpc.Code number; the number itself when it is none."""
    return _CODE_NAMES[code] if 0 <= code < len(_CODE_NAMES) else str(code)
