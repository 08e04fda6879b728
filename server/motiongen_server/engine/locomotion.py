"""The prompt of a velocity: one of the model's gaits, which holds while it leads."""

from __future__ import annotations

from collections.abc import Sequence

from motiongen_ardy.locomotion import gait
from motiongen_server.engine.types import Gait, Prompt, SetVelocity

# Gaits have no number among the prompts of clients, which start at 1.
GAIT_ID = 0


def gait_of(gaits: Sequence[Gait], event: SetVelocity, held: Gait | None) -> Gait | None:
    """The gait for a velocity; None where there is none, or the session's own prompts shall hold.

    held: the gait of the velocity that is in force.
    """
    return None if event.keep_prompt else gait.gait_of(gaits, event.x, event.z, event.heading, held)


def gait_prompt(gait: Gait) -> Prompt:
    """A gait as a prompt that holds whenever it is asked for."""
    return Prompt(GAIT_ID, None, None, gait.text, gait.embedding)
