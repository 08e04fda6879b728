"""`motiongen catalog`: print what a server offers."""

from __future__ import annotations

import argparse

from motiongen_client.types import Model
from motiongen_tools.connection import client_of
from motiongen_tools.console import make_console, make_table


async def catalog(options: argparse.Namespace) -> int:
    """Print models, rigs and limits."""
    console = make_console()
    async with client_of(options, options.server) as client:
        offered = client.catalog
    models = make_table("models", "name", "rig", "window", "steps", "parameters")
    # a table of their own: beside the rest they would not fit into a terminal of 80 columns
    origins = make_table("their text encoders and licences", "model", "text encoder", "licence")
    for model in offered.models:
        rig = offered.rig(model.rig_id)
        window = f"{model.horizon_frames} frames, {model.horizon_frames / rig.frame_rate_hz:g} s"
        steps = f"{model.default_denoise_steps} ({model.min_denoise_steps} to {model.max_denoise_steps})"
        size = f"{model.num_parameters / 1e6:.1f} M"
        models.add_row(model.model_id, model.rig_id, window, steps, size)
        origins.add_row(model.model_id, model.text_encoder, model.licence)
    trained = make_table("what the models were trained for", "model", "knows", "with a warning", "refused")
    for model in offered.models:
        if model.known_motions or model.constraint_forms:
            forms = [_forms(model, support) for support in ("untrained", "refused")]
            trained.add_row(model.model_id, ", ".join(model.known_motions) or "-", *forms)
    prompts = make_table("prompts", "model", "preset", "text", "what to expect")
    for model in offered.models:
        for name, text in model.presets.items():
            prompts.add_row(model.model_id, name, text, model.preset_descriptions.get(name, ""))
        for gait in model.locomotion_presets:
            speed = f"velocity {gait.direction} from {gait.from_speed_mps:.2g} m/s"
            speed += f", feet glide beyond {gait.to_speed_mps:.2g}" if gait.to_speed_mps else ""
            prompts.add_row(model.model_id, f"({gait.name})", gait.text, speed)
    rigs = make_table("rigs", "name", "joints", "frames a second", "numbers a frame")
    for rig in offered.rigs:
        rigs.add_row(rig.rig_id, str(rig.num_joints), str(rig.frame_rate_hz), str(rig.row_width))
    limits = make_table("limits", "name", "value")
    for name, value in vars(offered.limits).items():
        limits.add_row(name, f"{value:g}" if isinstance(value, float) else str(value))
    for table in (models, origins, trained, prompts, rigs, limits):
        if table.row_count:
            console.print(table)
    return 0


def _forms(model: Model, support: str) -> str:
    """The forms of constraints for which a model has this kind of support."""
    return ", ".join(form for form, how in model.constraint_forms.items() if how == support) or "-"
