"""The parameters of the simulation: measured ones and assumptions."""

from __future__ import annotations

from dataclasses import dataclass

CPU_CAPACITY = 206
"""Characters of the crowd that two cores serve in full, float32 (docs/performance/scenarios.md)."""
ENGINE_CAPACITY = 5_000
"""Characters that an engine process can handle with a model that takes no time: 0.2 ms per character and second."""


@dataclass(frozen=True)
class Assumptions:
    """capacity: characters that a server serves in full. admitted: the share of it up to which characters are admitted.

    Clients have `characters` each on average (geometric, at least one) and stay `life_s` on average (exponential).
    window_s: the motion that a window makes; lookahead_s: what a client holds. away_s: least and greatest time from the
    loss of a server to the open on another one. retry_s: after this time a refused client asks again; patience_s: after
    this time it gives up. start_s: from the request for a server until it is warm. target: the load that the autoscaler
    keeps; scale_every_s: how often it checks; growth: the most that it adds per minute, as a share. zones: how many
    zones servers are spread over. surge: the share of the servers that an upgrade replaces at once.
    """

    capacity: int = CPU_CAPACITY
    admitted: float = 0.93
    characters: float = 10.0
    life_s: float = 1200.0
    window_s: float = 2.0
    lookahead_s: float = 2.0
    away_s: tuple[float, float] = (0.08, 1.15)
    retry_s: float = 2.0
    patience_s: float = 60.0
    start_s: float = 60.0
    target: float = 0.6
    scale_every_s: float = 15.0
    growth: float = 0.5
    zones: int = 3
    surge: float = 0.05


@dataclass(frozen=True)
class Day:
    """When things happen, in seconds from the beginning. During the wave, clients arrive `wave` times as often."""

    ends_at: float = 4800.0
    warm_until: float = 600.0
    wave_at: float = 900.0
    wave_s: float = 120.0
    wave: float = 6.0
    zone_fails_at: float = 1800.0
    zone_back_at: float = 2400.0
    upgrade_at: float = 3000.0
