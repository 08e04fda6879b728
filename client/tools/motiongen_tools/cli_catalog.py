"""`motiongen catalog`: what a server offers."""

from __future__ import annotations

import argparse

from motiongen_client.client import MotionClient
from motiongen_tools.console import make_console, make_table


async def catalog(options: argparse.Namespace) -> int:
    """Print models, rigs and limits."""
    console = make_console()
    async with MotionClient(options.server) as client:
        offered = client.catalog
    models = make_table("models", "name", "rig", "window", "steps", "parameters", "text encoder", "licence")
    for model in offered.models:
        rig = offered.rig(model.rig_id)
        window = f"{model.horizon_frames} frames, {model.horizon_frames / rig.frame_rate_hz:g} s"
        steps = f"{model.default_denoise_steps} ({model.min_denoise_steps} to {model.max_denoise_steps})"
        size = f"{model.num_parameters / 1e6:.1f} M"
        models.add_row(model.model_id, model.rig_id, window, steps, size, model.text_encoder, model.licence)
    rigs = make_table("rigs", "name", "joints", "frames a second", "numbers a frame")
    for rig in offered.rigs:
        rigs.add_row(rig.rig_id, str(rig.num_joints), str(rig.frame_rate_hz), str(rig.row_width))
    limits = make_table("limits", "name", "value")
    for name, value in vars(offered.limits).items():
        limits.add_row(name, f"{value:g}" if isinstance(value, float) else str(value))
    for table in (models, rigs, limits):
        console.print(table)
    return 0
