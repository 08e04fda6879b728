"""Options with which a session is opened, and which may change while it is open."""

from __future__ import annotations

import math
from collections.abc import Sequence

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import ChannelBlock, Guidance, ModelFacts, Priority, SessionKey, SetOptions
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert.checks import check_range, refuse
from motiongen_server.rpc.convert.frames import F32, QUANTISED, SCALAR_TYPES, FrameCoding
from motiongen_server.rpc.convert.history import history_frames_of
from motiongen_server.rpc.convert.output_coding import is_quantised
from motiongen_server.rpc.limits import MAX_GUIDANCE


def set_options_of(
    message: session_pb2.SetOptions, key: SessionKey, sequence: int, received_at: float, catalog: Catalog
) -> SetOptions:
    """The engine's event. Raises EventRefused."""
    field = "set_options"
    return SetOptions(
        key,
        sequence,
        received_at,
        priority=priority_of(message.priority, field) if message.HasField("priority") else None,
        lookahead=lookahead_of(message.lookahead_frames, field, catalog)
        if message.HasField("lookahead_frames")
        else None,
        denoise_steps=steps_of(message.denoise_steps, field, catalog) if message.HasField("denoise_steps") else None,
        guidance=guidance_of(message.guidance, catalog.guidance, field) if message.HasField("guidance") else None,
        history_frames=history_frames_of(message, catalog.facts, field),
    )


def coding_of(message: session_pb2.OpenSession, catalog: Catalog) -> FrameCoding:
    """What a session's frames hold and how they are encoded; F32_LE by default. Raises EventRefused."""
    scalar_type = int(message.scalar_type) or F32
    if scalar_type not in SCALAR_TYPES:
        given = f"scalar type {scalar_type} is not offered"
        raise refuse("INVALID_SCALAR_TYPE", "open.scalar_type", given, "F32_LE, F16_LE or QUANTISED")
    outputs = outputs_named(message.outputs, catalog.facts)
    for index, block in enumerate(outputs):
        if scalar_type == QUANTISED and not is_quantised(block.name):
            allowed = "F32_LE or F16_LE beside it"
            raise refuse("OUTPUT_NOT_QUANTISED", f"open.outputs[{index}]", f"{block.name} is not quantised", allowed)
    return FrameCoding(scalar_type, len(catalog.facts.rig.joint_names), outputs)


def outputs_named(names: Sequence[str], facts: ModelFacts) -> tuple[ChannelBlock, ...]:
    """The blocks of these names, in their order. Raises EventRefused if one is not offered, or comes twice."""
    offered = {block.name: block for block in facts.outputs}
    for index, name in enumerate(names):
        if name not in offered or name in names[:index]:
            given = f"{name[:80]!r} comes twice" if name in names[:index] else f"no output {name[:80]!r}"
            allowed = f"each of {', '.join(offered)} once" if offered else "none"
            raise refuse("UNKNOWN_OUTPUT", f"open.outputs[{index}]", given, allowed)
    return tuple(offered[name] for name in names)


def priority_of(priority: int, field: str) -> Priority:
    """UNSPECIFIED is NEAR."""
    if priority not in (0, *Priority):
        given, allowed = f"priority {priority} does not exist", "HERO, NEAR, CROWD or BATCH"
        raise refuse("INVALID_PRIORITY", f"{field}.priority", given, allowed)
    return Priority(priority or Priority.NEAR)


def lookahead_of(frames: int, field: str, catalog: Catalog) -> int:
    """0 stands for the default."""
    lookahead, limits = frames or catalog.limits.default_lookahead_frames, catalog.limits
    name = f"{field}.lookahead_frames"
    check_range(lookahead, catalog.facts.horizon, limits.max_lookahead_frames, "LOOKAHEAD_OUT_OF_RANGE", name)
    return lookahead


def asked_steps(message: session_pb2.OpenSession, facts: ModelFacts) -> int:
    """The denoising steps that a session asks for, unchecked; by default the model's own."""
    return message.denoise_steps if message.HasField("denoise_steps") else facts.default_steps


def steps_of(steps: int, field: str, catalog: Catalog) -> int:
    facts = catalog.facts
    check_range(steps, facts.min_steps, facts.max_steps, "DENOISE_STEPS_OUT_OF_RANGE", f"{field}.denoise_steps")
    return steps


def guidance_of(message: session_pb2.Guidance, default: Guidance, field: str) -> Guidance:
    """Weights that are absent are the model's own."""
    weights = {}
    for name in ("text", "constraint"):
        weight = getattr(message, name) if message.HasField(name) else getattr(default, name)
        if not (math.isfinite(weight) and 0 <= weight <= MAX_GUIDANCE):
            reason = "GUIDANCE_OUT_OF_RANGE" if math.isfinite(weight) else "NOT_FINITE"
            raise refuse(reason, f"{field}.guidance.{name}", f"the weight is {weight}", f"0 to {MAX_GUIDANCE:g}")
        weights[name] = float(weight)
    return Guidance(**weights)
