"""The engine's outputs -> protocol messages, except frames and plans, which `wire` encodes."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import (
    Closed,
    ConstraintReached,
    Deviation,
    Durable,
    Opened,
    Outcome,
    Output,
    Placement,
    ServiceLevel,
    Warned,
)
from motiongen_server.replicas.hint import RefusedOpen


def write_update(update: session_pb2.SessionUpdate, output: Output) -> None:
    """Fill an update with any output but frames and plans; the stream fills in `session` and `applied_seq`."""
    if isinstance(output, Outcome):
        _write_outcome(update.outcome, output)
    elif isinstance(output, ConstraintReached):
        _write_reached(update.constraint_reached, output)
    elif isinstance(output, Opened):
        _write_opened(update.opened, output)
    elif isinstance(output, ServiceLevel):
        update.service_level.tier = output.tier.value  # type: ignore[assignment]  # the engine's numbers are the protocol's
        update.service_level.denoise_steps = output.denoise_steps
    elif isinstance(output, Durable):
        update.durable_seq = output.durable_seq
        update.durability.is_kept = output.is_kept
    elif isinstance(output, Closed):
        closed = update.closed
        closed.reason = output.reason.value  # type: ignore[assignment]
        closed.code = output.code
        closed.message = output.message
        closed.frames = output.num_frames
        closed.late_frames = output.late_frames


def _write_reached(message: session_pb2.ConstraintReached, output: ConstraintReached) -> None:
    message.constraint_id = output.constraint_id
    message.met = output.met
    message.frame = output.frame
    if output.position_m is not None:
        message.position_error_m = output.position_m.worst
    angles = [each.worst for each in (output.heading_rad, output.rotation_rad) if each is not None]
    if angles:
        message.rotation_error_rad = max(angles)


def residual_of(reached: ConstraintReached) -> service_pb2.ConstraintResidual:
    """A constraint's residual for the summary of a clip."""
    residual = service_pb2.ConstraintResidual(
        constraint_id=reached.constraint_id, frame_count=reached.num_frames, met=reached.met
    )
    for name in ("position_m", "heading_rad", "rotation_rad"):
        deviation: Deviation | None = getattr(reached, name)
        if deviation is not None:
            getattr(residual, name).mean, getattr(residual, name).worst = deviation.mean, deviation.worst
    return residual


def _write_opened(opened: session_pb2.SessionOpened, output: Opened) -> None:
    opened.session_id = output.session_id
    opened.session_token = output.session_token
    opened.seed = output.seed
    opened.start_frame = output.start_frame
    opened.rig_id = output.rig_id
    opened.model_id = output.model_id
    opened.frame_rate = output.fps
    opened.lookahead_frames = output.lookahead
    opened.committed_horizon_frames = output.committed_horizon
    opened.denoise_steps = output.denoise_steps
    opened.scalar_type = output.scalar_type  # type: ignore[assignment]  # a number of the contract
    opened.outputs.extend(motion_pb2.ChannelBlock(name=block.name, width=block.width) for block in output.outputs)
    opened.warnings.extend(_warnings(output.warnings))
    opened.placements.extend(_placements(output.placements))


def _write_outcome(message: session_pb2.EditOutcome, outcome: Outcome) -> None:
    message.event_seq = outcome.event_seq
    message.code = outcome.code
    if outcome.effective_frame is not None:
        message.effective_frame = outcome.effective_frame
    if outcome.reason:
        message.reason = outcome.reason
        message.message = outcome.message
        message.field = outcome.field
        message.allowed = outcome.allowed
    if outcome.retry_after_s is not None:
        message.retry_after.FromMilliseconds(max(1, round(1000 * outcome.retry_after_s)))
    if outcome.warnings:
        message.warnings.extend(_warnings(outcome.warnings))
    if outcome.placements:
        message.placements.extend(_placements(outcome.placements))
    if isinstance(outcome, RefusedOpen):
        for address, routing_key in outcome.other_servers:
            message.other_servers.add(address=address, routing_key=routing_key)


def _placements(placements: Iterable[Placement]) -> Iterable[motion_pb2.ConstraintPlacement]:
    for each in placements:
        yield motion_pb2.ConstraintPlacement(
            constraint_id=each.constraint_id,
            first_frame=each.first_frame,
            last_frame=each.last_frame,
            arrival_frame=each.arrival_frame,
            anchor_frame=each.anchor_frame,
            anchor_x=each.x,
            anchor_z=each.z,
            anchor_heading=each.heading,
        )


def _warnings(warnings: Iterable[Warned]) -> Iterable[session_pb2.EventWarning]:
    for each in warnings:
        yield session_pb2.EventWarning(reason=each.reason, message=each.message, field=each.field)
