"""The catalog: what a server offers, as a message for clients."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import DEFAULT_TOLERANCE, ChannelBlock, Gait, Guidance, ModelFacts
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities
from motiongen_server.rpc.limits import MAX_COORDINATE_M, MAX_GUIDANCE, MAX_SPEED_MPS, Limits
from motiongen_server.text.presets import Preset


class Catalog:
    """One model, its rig and the limits; never changes while the server runs."""

    def __init__(
        self,
        facts: ModelFacts,
        limits: Limits,
        guidance: Guidance,
        licence: str,
        *,
        text_encoder: str,
        history_frames: int,
        presets: Sequence[Preset] = (),
        gaits: Sequence[Gait] = (),
        abilities: Abilities = NOTHING_CLAIMED,
    ) -> None:
        """history_frames: the history given to a window; what it leaves of the window is horizon and future.

        gaits: the prompts of velocities. abilities: what the model was trained for.
        """
        self.gaits = tuple(gaits)
        self.abilities = abilities
        self.text_encoder = text_encoder
        self.presets = {preset.preset_id: preset for preset in presets}
        self.facts = facts
        self.limits = limits
        self.guidance = guidance
        self.limits_message = service_pb2.Limits(
            max_sessions_per_stream=limits.max_sessions_per_stream,
            max_constraints=limits.max_constraints,
            max_lookahead_frames=limits.max_lookahead_frames,
            max_prompts=limits.max_prompts,
            max_prompt_characters=limits.max_prompt_characters,
            max_request_bytes=limits.max_request_bytes,
            default_lookahead_frames=limits.default_lookahead_frames,
            max_trajectory_frames=limits.max_trajectory_frames,
            max_held_trajectory_frames=limits.max_held_trajectory_frames,
            max_coordinate_m=MAX_COORDINATE_M,
            max_guidance=MAX_GUIDANCE,
            max_speed_mps=MAX_SPEED_MPS,
            max_hold_frames=limits.max_hold_frames,
            max_clip_frames=limits.max_clip_frames,
            max_clip_samples=limits.max_clip_samples,
            max_events_per_second=limits.events_per_second,
            max_stream_events_per_second=limits.stream_events_per_second,
        )
        self.limits_message.resume_grace.FromMilliseconds(round(1000 * limits.resume_grace_s))
        to_mps = {(gait.direction, gait.from_mps): gait.to_mps for gait in abilities.gaits}
        model = service_pb2.Model(
            model_id=facts.model_id,
            rig_id=facts.rig.rig_id,
            licence=licence,
            horizon_frames=facts.horizon,
            patch_frames=facts.patch,
            default_denoise_steps=facts.default_steps,
            min_denoise_steps=facts.min_steps,
            max_denoise_steps=facts.max_steps,
            text_encoder=text_encoder,
            text_width=facts.embedding_dim,
            presets=[
                service_pb2.Preset(preset_id=preset.preset_id, text=preset.text, description=preset.description)
                for preset in presets
            ],
            default_guidance=session_pb2.Guidance(text=guidance.text, constraint=guidance.constraint),
            num_parameters=facts.num_parameters,
            future_frames=facts.max_window_frames - facts.horizon - history_frames,
            default_history_frames=history_frames,
            max_history_frames=facts.max_history // facts.patch * facts.patch,
            constraint_forms=[
                service_pb2.ConstraintForm(form=form, support=support.value)  # type: ignore[arg-type]  # as the protocol
                for form, support in self.abilities.forms.items()
            ],
            locomotion_presets=[
                locomotion_message(gait, to_mps.get((gait.direction, gait.from_mps), math.inf)) for gait in gaits
            ],
            known_motions=self.abilities.known_motions,
            default_tolerance_m=DEFAULT_TOLERANCE.position_m,
            default_tolerance_rad=DEFAULT_TOLERANCE.angle_rad,
            outputs=block_messages(facts.outputs),
        )
        self._response = service_pb2.GetCatalogResponse(
            rigs=[rig_message(facts)], limits=self.limits_message, models=[model]
        )
        content = self._response.SerializeToString(deterministic=True)
        self._response.catalog_etag = hashlib.sha256(content).hexdigest()[:16]

    def response(self, known_etag: str) -> service_pb2.GetCatalogResponse:
        """The catalog, or only its etag for a client that has it already."""
        if known_etag == self._response.catalog_etag:
            return service_pb2.GetCatalogResponse(catalog_etag=known_etag)
        return self._response


def locomotion_message(gait: Gait, to_mps: float) -> service_pb2.LocomotionPreset:
    """The prompt of a velocity. to_mps: the speed up to which characters step; infinity: nothing is claimed."""
    return service_pb2.LocomotionPreset(
        name=gait.name,
        text=gait.text,
        from_speed_mps=gait.from_mps,
        direction=gait.direction.name.lower(),
        to_speed_mps=to_mps if math.isfinite(to_mps) else 0.0,
    )


def rig_message(facts: ModelFacts) -> motion_pb2.Rig:
    """The rig of a model, with the layout of its frame rows."""
    return motion_pb2.Rig(
        rig_id=facts.rig.rig_id,
        joints=facts.rig.joint_names,
        parents=facts.rig.parents,
        frame_rate=facts.fps,
        blocks=block_messages(facts.rig.blocks),
        neutral_offsets_m=facts.rig.neutral_offsets.ravel().tolist(),
        hip_joints=facts.rig.hip_joints or (),
        limbs=[motion_pb2.Limb(name=limb.name, joints=limb.joints) for limb in facts.rig.limbs],
    )


def block_messages(blocks: Sequence[ChannelBlock]) -> list[motion_pb2.ChannelBlock]:
    """Blocks of a row, in their order."""
    return [motion_pb2.ChannelBlock(name=block.name, width=block.width) for block in blocks]
