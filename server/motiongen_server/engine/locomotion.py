"""The prompt for a velocity: one of the model's gaits, in force while the velocity is."""

from __future__ import annotations

from collections.abc import Sequence

from motiongen_ardy.locomotion import gait
from motiongen_server.engine.types import Gait, Prompt, SetVelocity

# Not an id that a client can choose: those start at 1.
GAIT_ID = 0


def gait_of(gaits: Sequence[Gait], event: SetVelocity, held: Gait | None) -> Gait | None:
    """The gait for a velocity; None if the model has none for it or the session's own prompts are to stay in force.

    held: the gait of the velocity that is in force.
    """
    return None if event.keep_prompt else gait.gait_of(gaits, event.x, event.z, event.heading, held)


def gait_prompt(gait: Gait) -> Prompt:
    """A gait as a prompt for any frames."""
    return Prompt(GAIT_ID, None, None, gait.text, gait.embedding)
