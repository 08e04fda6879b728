"""The facts of a model, for the engine and the catalogue."""

from __future__ import annotations

import numpy as np

from motiongen_ardy.core.constraint import limb_chains
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights, needed_passes
from motiongen_ardy.model.model import Model
from motiongen_server.engine.types import ChannelBlock, Guidance, Limb, ModelFacts, RigLayout
from motiongen_server.runner.outputs import output_blocks

MIN_STEPS = 2  # one step alone would tell the model that pure noise is almost clean


def model_facts(model: Model, model_id: str, default_steps: int) -> ModelFacts:
    """The facts of a loaded model. model_id: the name by which clients ask for it."""
    skeleton, config, own = model.skeleton, model.config, model.sampling.guidance
    return ModelFacts(
        model_id=model_id,
        rig=RigLayout(
            rig_id=skeleton.name,
            joint_names=skeleton.joint_names,
            parents=skeleton.parents,
            neutral_offsets=skeleton.offsets.astype(np.float32),
            blocks=(
                ChannelBlock("root_translation_m", 3),
                ChannelBlock("joint_rotation_quat_wxyz", 4 * skeleton.num_joints),
                ChannelBlock("foot_contact", 4),
            ),
            hip_joints=skeleton.hip_joints,
            limbs=tuple(Limb(name, joints) for name, joints in limb_chains(skeleton).items()),
        ),
        fps=config.fps,
        horizon=config.horizon,
        patch=config.patch,
        feature_dim=skeleton.feature_dim,
        max_window_frames=config.max_window_frames,
        min_steps=min(MIN_STEPS, config.num_base_steps),
        max_steps=config.num_base_steps,
        default_steps=min(default_steps, config.num_base_steps),
        embedding_dim=config.denoiser.text_dim,
        token_width=config.token_width,
        guidance_passes=len(needed_passes(own.mode, GuidanceWeights(own.text, own.constraint), True, True)),
        guidance=Guidance(own.text, own.constraint),
        guidance_joint=own.mode == "joint",
        steered_share=model.sampling.steered_share,
        longest_flight=round(model.sampling.longest_flight_s * config.fps),
        num_parameters=model.num_parameters,
        outputs=output_blocks(skeleton),
    )
