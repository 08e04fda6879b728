"""Converts what a client sends to messages."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_client.convert.frames import SCALAR_TYPES
from motiongen_client.motion import Motion
from motiongen_client.prompts import Preset, Prompt, TextEmbedding
from motiongen_client.types import (
    Constraint,
    Flexible,
    FootContact,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Priority,
    RootPath,
    RootTrajectory,
    SessionOptions,
    StartPose,
    Waypoint,
    check_target,
    check_text,
)

_PRIORITIES = {
    Priority.HERO: session_pb2.PRIORITY_CLASS_HERO,
    Priority.NEAR: session_pb2.PRIORITY_CLASS_NEAR,
    Priority.CROWD: session_pb2.PRIORITY_CLASS_CROWD,
    Priority.BATCH: session_pb2.PRIORITY_CLASS_BATCH,
}


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
        scalar_type=SCALAR_TYPES[options.frame_format],
        prompts=prompts,
        constraints=constraints,
        denoise_steps=options.denoise_steps,
        history_frames=options.history_frames,
        keep_prompts=options.keep_prompts,
        outputs=options.outputs,
    )
    if options.prior is not None:
        message.prior_frames.CopyFrom(_prior_frames(options.prior))
    if options.start != StartPose():
        message.start_pose.CopyFrom(_start_pose(options.start))
    if options.text_guidance is not None or options.constraint_guidance is not None:
        message.guidance.CopyFrom(
            session_pb2.Guidance(text=options.text_guidance, constraint=options.constraint_guidance)
        )
    return message


def seek(start: StartPose | None, prior: Motion | None) -> session_pb2.Seek:
    """The message that cuts a character to a start pose, or to continue from other frames."""
    message = session_pb2.Seek()
    if prior is not None:
        message.prior_frames.CopyFrom(_prior_frames(prior))
    else:
        message.start_pose.CopyFrom(_start_pose(start or StartPose()))
    return message


def _prior_frames(prior: Motion) -> motion_pb2.FrameChunk:
    data = np.ascontiguousarray(prior.own().rows, "<f4").tobytes()
    return motion_pb2.FrameChunk(frame_count=len(prior), scalar_type=motion_pb2.SCALAR_TYPE_F32_LE, data=data)


def _start_pose(start: StartPose) -> session_pb2.StartPose:
    return session_pb2.StartPose(x=start.x_m, z=start.z_m, heading=start.heading_rad)


def set_options(
    priority: Priority | None,
    lookahead_frames: int | None,
    denoise_steps: int | None,
    guidance: tuple[float | None, float | None] | None,
    history_frames: int | None,
) -> session_pb2.SetOptions:
    """The message that changes options. guidance: of text and of constraints; None within it: the model's own."""
    message = session_pb2.SetOptions(
        priority=None if priority is None else _PRIORITIES[priority],
        lookahead_frames=lookahead_frames,
        denoise_steps=denoise_steps,
        history_frames=history_frames,
    )
    if guidance is not None:
        message.guidance.CopyFrom(session_pb2.Guidance(text=guidance[0], constraint=guidance[1]))
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
    """A prompt in force from a frame on, or as soon as possible, up to another frame or to the end.

    Raises InvalidInput for anything else than a prompt, and for a text that cannot be encoded as UTF-8.
    """
    span = motion_pb2.PromptSpan(prompt_id=prompt_id, start_frame=start_frame or 0, end_frame=end_frame or 0)
    match prompt:
        case Preset():
            span.preset_id = prompt.preset_id
        case TextEmbedding():
            span.text = prompt.text
            span.embedding.text_encoder = prompt.text_encoder
            span.embedding.values.extend(np.asarray(prompt.values, np.float32).tolist())
        case _:
            check_text("prompt", prompt, "a text that UTF-8 can write, a Preset or a TextEmbedding")
            span.text = prompt
    return span


def constraint(constraint_id: int, asked: Constraint) -> motion_pb2.Constraint:
    """A constraint with its id, by which it can be replaced or removed later. Raises InvalidInput if it is none."""
    target = asked.target if isinstance(asked, Flexible) else asked
    check_target("constraint", target)
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
        case FootContact():
            message.foot_contact.CopyFrom(
                motion_pb2.FootContact(limb=target.limb, x=target.x_m, z=target.z_m, heading=target.heading_rad)
            )
        case HeadingTarget():
            message.heading.CopyFrom(motion_pb2.HeadingTarget(heading=target.heading_rad))  # also for a heading of 0
        case JointRotations():
            message.joint_rotations.joints.extend(target.joints)
            message.joint_rotations.rotations.extend(target.rotations_quat_wxyz.ravel().tolist())
        case JointTargets():
            message.joint_targets.joints.extend(target.joints)
            message.joint_targets.positions.extend(target.positions_m.ravel().tolist())
            if target.rotations_quat_wxyz is not None:
                message.joint_targets.rotations.extend(target.rotations_quat_wxyz.ravel().tolist())
    return message


def ping(now_ns: int, round_trip_s: float | None) -> service_pb2.Ping:
    """A ping. round_trip_s: as measured by the last one; None before the first."""
    message = service_pb2.Ping(client_time_ns=now_ns)
    if round_trip_s is not None:
        message.round_trip.FromNanoseconds(round(1e9 * round_trip_s))
    return message
