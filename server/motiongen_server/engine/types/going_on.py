"""Checks whether a session can continue from a snapshot: that it fits the model here and the client's state.

The edge checks before it takes a session over from another server, and the engine before it opens it: otherwise only
the model would find the mistake, in the middle of a step of other sessions.
"""

from __future__ import annotations

import numpy as np

from motiongen_server.engine.types.facts import ModelFacts
from motiongen_server.engine.types.names import Code
from motiongen_server.engine.types.outputs import Opened
from motiongen_server.engine.types.refusals import EventRefused
from motiongen_server.engine.types.snapshot import GoingOn, SessionSnapshot


def check_going_on(asked: GoingOn, facts: ModelFacts) -> None:
    """Raise EventRefused if the model, or the client, cannot continue from a snapshot."""
    held = asked.snapshot
    if why := _misfit(held, facts):
        raise unusable(f"it does not fit the model served here: {why}")
    # A plan newer than the snapshot may have replaced frames that it holds, and its own can never be made again.
    if asked.plan > held.plan or not held.first_frame <= asked.next_frame <= held.end_frame:
        raise unusable(
            f"it holds frames {held.first_frame} to {held.end_frame - 1} of plans up to {held.plan}, and the client is "
            f"at frame {asked.next_frame} of plan {asked.plan}"
        )


def check_told(told: Opened, facts: ModelFacts) -> None:
    """Raise EventRefused if frames here differ from what the client was told when its session was opened."""
    if (told.rig_id, told.fps) != (facts.rig.rig_id, facts.fps):
        raise unusable(
            f"its frames are of the rig {told.rig_id[:80]!r}, {told.fps} a second, and those of {facts.model_id} here "
            f"of {facts.rig.rig_id!r}, {facts.fps} a second"
        )
    for block in told.outputs:
        if block not in facts.outputs:
            raise unusable(f"its frames have {block.width} numbers of {block.name[:80]!r}, which are not made here")


def unusable(why: str) -> EventRefused:
    """The refusal of a resume whose saved state cannot be used here, or not by this client."""
    given = f"the session cannot be continued from its snapshot: {why}"
    allowed = "a new session that continues from the frames held: open.prior_frames"
    return EventRefused(Code.FAILED_PRECONDITION, "SNAPSHOT_UNUSABLE", given, "open.resume_token", allowed)


def _misfit(held: SessionSnapshot, facts: ModelFacts) -> str:
    """What in a snapshot does not fit the model, "" if all fits. Servers may have different models under one name."""
    spec, rows = held.spec, held.rows
    if spec.model_id != facts.model_id:
        return f"it is of the model {spec.model_id[:80]!r}"
    if rows.ndim != 2 or rows.shape[1] != facts.row_width or len(rows) < facts.patch:
        return f"its frames are of shape {rows.shape}"
    if not np.isfinite(rows).all():
        return "its frames are not finite"
    embeddings = [each.embedding for each in (*held.prompts, held.gait) if each is not None]
    if any(each.ndim not in (1, 2) or each.shape[-1] != facts.embedding_dim for each in embeddings):
        return f"its prompts are not of {facts.embedding_dim} numbers each"
    if not facts.min_steps <= spec.denoise_steps <= facts.max_steps:
        return f"it takes {spec.denoise_steps} denoising steps"
    if spec.lookahead < facts.horizon:
        return f"its look-ahead is {spec.lookahead} frames"
    history = facts.patch if spec.history_frames is None else spec.history_frames
    if history % facts.patch or not facts.patch <= history <= facts.max_history:
        return f"its windows see a history of {history} frames"
    if not set(spec.outputs) <= {block.name for block in facts.outputs}:
        return f"its frames have {', '.join(spec.outputs)[:80]}"
    return ""
