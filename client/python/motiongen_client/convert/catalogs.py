"""Converts catalogues from messages, and rejects those that contradict themselves."""

from __future__ import annotations

import numpy as np

from motiongen.v1 import motion_pb2, service_pb2
from motiongen_client.convert.outputs import WIDEST_ROW
from motiongen_client.errors import ProtocolViolation
from motiongen_client.motion import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK, Rig
from motiongen_client.types import (
    Catalog,
    Limits,
    LocomotionPreset,
    Model,
)

_MOST_REQUEST_BYTES = 8 * 1024 * 1024
"""Cap on a server's max_request_bytes, since the client must hold each message in memory."""


def catalog(message: service_pb2.GetCatalogResponse) -> Catalog:
    """The catalogue. Raises ProtocolViolation if a rig contradicts itself."""
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
                    LocomotionPreset(each.name, each.text, each.from_speed_mps, each.direction, each.to_speed_mps)
                    for each in entry.locomotion_presets
                ),
                known_motions=tuple(entry.known_motions),
                default_text_guidance=_weight(entry, "text"),
                default_constraint_guidance=_weight(entry, "constraint"),
                default_tolerance_m=entry.default_tolerance_m,
                default_tolerance_rad=entry.default_tolerance_rad,
                outputs={block.name: block.width for block in entry.outputs},
            )
            for entry in message.models
        ),
        limits=Limits(
            max_sessions_per_stream=limits.max_sessions_per_stream,
            max_constraints=limits.max_constraints,
            max_prompts=limits.max_prompts,
            max_prompt_characters=limits.max_prompt_characters,
            max_trajectory_frames=limits.max_trajectory_frames,
            max_request_bytes=min(limits.max_request_bytes, _MOST_REQUEST_BYTES),
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
            max_held_trajectory_frames=limits.max_held_trajectory_frames,
        ),
        free_share=message.free_share if message.HasField("free_share") else None,
    )


def rig(message: motion_pb2.Rig) -> Rig:
    """A rig. Raises ProtocolViolation if its counts do not agree or a block that this package reads is missing.

    Also raises it for a row wider than `WIDEST_ROW`, joints that form no tree, and offsets that are not finite.
    """
    num_joints = len(message.joints)
    blocks = {block.name: block.width for block in message.blocks}
    widths = {ROOT_BLOCK: 3, ROTATION_BLOCK: 4 * num_joints, CONTACT_BLOCK: 4}
    for name, width in widths.items():
        if blocks.get(name) != width:
            raise ProtocolViolation(f"rig {message.rig_id}: block {name} has width {blocks.get(name)}, not {width}")
    if not num_joints or sum(blocks.values()) > WIDEST_ROW:
        raise ProtocolViolation(f"rig {message.rig_id}: {num_joints} joints in rows of {sum(blocks.values())} numbers")
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
    if not np.isfinite(message.neutral_offsets_m).all():
        raise ProtocolViolation(f"rig {message.rig_id}: an offset is not finite")
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


def _weight(model: service_pb2.Model, condition: str) -> float:
    """The default guidance of "text" or "constraint"; 1, for which models are trained, if the server states none."""
    guidance = model.default_guidance
    return float(getattr(guidance, condition)) if guidance.HasField(condition) else 1.0


_FORM_SUPPORTS = frozenset(service_pb2.FormSupport.values())


def _support_name(support: int) -> str:
    name = service_pb2.FormSupport.Name(support) if support in _FORM_SUPPORTS else "UNSPECIFIED"
    return name.removeprefix("FORM_SUPPORT_").lower()
