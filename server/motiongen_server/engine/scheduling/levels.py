"""Levels: how windows are made under load, from everything that was asked for down to none at all."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.types import ModelFacts, ServiceTier

# The shares of a class's sessions that are held, level by level.
_HELD_SHARES = (0.15, 0.3, 0.5, 0.75, 1.0)


@dataclass(frozen=True, slots=True)
class Level:
    """How windows are made from the next one on.

    steps: most denoising steps of a window, None for as many as the session asked for. drop_guidance: one evaluation
    per step. full_stride: a running window is finished rather than restarted for an edit. replan_cap_scale: scales the
    most replans per second. hold: no windows are made, the character stands. others: the level of those sessions of a
    class that are not held, None if all are; held_share: the share that is held.
    """

    tier: ServiceTier
    steps: int | None = None
    drop_guidance: bool = False
    full_stride: bool = False
    replan_cap_scale: float = 1.0
    hold: bool = False
    held_share: float = 0.0
    others: Level | None = None

    @property
    def of_newcomers(self) -> Level:
        """The level of a session opened while its class is on this one: it is held only if all others are."""
        return self.others or self

    def of_class(self, sessions: int) -> list[Level]:
        """The level of each session of a class, the oldest first: the newest are held."""
        held = math.ceil(self.held_share * sessions)
        return [self.of_newcomers] * (sessions - held) + [self] * held if self.hold else [self] * sessions

    def kept(self, facts: ModelFacts, prices: Prices) -> float:
        """The share of a class's full use of the machine that remains on this level, 0 to 1, replans included."""
        steps = facts.default_steps if self.steps is None else min(self.steps, facts.default_steps)
        in_full = prices.whole_s(facts.default_steps)
        if not in_full:
            return 1.0 - self.held_share
        passes = 1.0 / facts.guidance_passes if self.drop_guidance else 1.0
        return (1.0 - self.held_share) * (passes * steps * prices.step_s + prices.window_s) / in_full


FULL = Level(ServiceTier.FULL)


def levels_of(facts: ModelFacts) -> tuple[Level, ...]:
    """The levels for a model, most first: fewer steps twice, then no guidance, then more and more sessions held."""
    steps = [max(facts.min_steps, math.ceil(share * facts.default_steps)) for share in (0.6, 0.4)]
    levels = [FULL, Level(ServiceTier.FULL, full_stride=True, replan_cap_scale=0.5)]
    levels += [
        Level(ServiceTier.FEWER_STEPS, count, full_stride=True, replan_cap_scale=0.5)
        for count in dict.fromkeys(steps)
        if count < facts.default_steps
    ]
    if facts.guidance_passes > 1:
        levels.append(
            Level(ServiceTier.NO_GUIDANCE, steps[-1], drop_guidance=True, full_stride=True, replan_cap_scale=0.5)
        )
    least = levels[-1]
    levels += [
        replace(
            least,
            tier=ServiceTier.HOLD,
            steps=steps[-1],
            replan_cap_scale=0.25,
            hold=True,
            held_share=share,
            others=least if share < 1.0 else None,
        )
        for share in _HELD_SHARES
    ]
    return tuple(levels)
