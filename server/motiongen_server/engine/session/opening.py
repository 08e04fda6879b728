"""Opens a session, and changes its options later."""

from __future__ import annotations

import math
from dataclasses import dataclass

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.constraint_edits import by_last, of_last, place_all
from motiongen_server.engine.session.delivery import Delivery
from motiongen_server.engine.session.drift import DriftGuard, DriftState
from motiongen_server.engine.session.edits import EditQueue
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.session.playback import PlaybackClock, RoundTrip
from motiongen_server.engine.session.pose import PoseReader
from motiongen_server.engine.session.prompt_edits import upserted
from motiongen_server.engine.session.reach import ReachWatch
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.session.timeline import first_timeline
from motiongen_server.engine.session.windows import root_before
from motiongen_server.engine.spread import spread
from motiongen_server.engine.types import Float32Array, ModelFacts, SessionSpec


@dataclass(frozen=True, slots=True)
class Opening:
    """What the engine contributes to a new session.

    ordinal: how many sessions were opened before; it spreads the start times of later windows. now: on the engine's
    clock.
    """

    ordinal: int
    facts: ModelFacts
    config: EngineConfig
    now: float


def open_session(
    spec: SessionSpec, received_at: float, opening: Opening, prior_features: Float32Array | None = None
) -> SessionState:
    """A new session.

    prior_features: (H, D), the features of spec.prior_rows, None if there are none. Raises EventRefused for a
    constraint that cannot be placed.
    """
    facts, config = opening.facts, opening.config
    timeline = first_timeline(facts, spec.prior_rows, prior_features)
    reader = PoseReader.of(facts.rig)
    last_frame = None if spec.clip_frames is None else spec.clip_frames - 1
    start = root_before(0, timeline, reader, spec.start_pose, facts.fps)
    constraints, placements = place_all(
        spec.constraints,
        lambda: Anchor(0, start, facts.fps, facts.rig, last_frame),
        "open.constraints",
        config.max_held_trajectory_frames,
    )
    if not spec.is_clip:  # a clip keeps all its constraints, and answers each, even those that share an id
        constraints, placements = by_last(constraints), of_last(placements, spec.constraints)
    clock = PlaybackClock(facts.fps, rate=config.playback_rate, slack=spec.lookahead)
    stride = spread(opening.ordinal) * (config.stride_jitter // facts.patch + 1)
    jitter = math.floor(stride % 1.0 * (config.continue_jitter + 1))
    return SessionState(
        spec=spec,
        facts=facts,
        config=config,
        continue_threshold=_continue_threshold(spec, facts, config) + jitter,
        cut_frames=math.floor(stride) * facts.patch,
        conditions=Conditions(upserted((), spec.prompts, 0), constraints),
        delivery=Delivery(spec.session, spec.lookahead, config, clock, RoundTrip(config.rtt_s)),
        timeline=timeline,
        edits=EditQueue(config.max_waiting_edits),
        drift_state=DriftState(DriftGuard(reader, config, facts.longest_flight)),
        reach=ReachWatch(spec.session),
        opened_at=received_at,
        last_playhead_at=opening.now,
        moved_at=opening.now,
        placements=placements,
    )


def change_options(state: SessionState, changed: SessionSpec) -> None:
    """Use other options from the next window on. Frames already sent beyond a shorter look-ahead are not taken back."""
    before, facts, config = state.spec, state.facts, state.config
    state.spec = changed
    state.continue_threshold += _continue_threshold(changed, facts, config) - _continue_threshold(before, facts, config)
    state.delivery.lookahead = changed.lookahead
    state.clock.slack = changed.lookahead


def _continue_threshold(spec: SessionSpec, facts: ModelFacts, config: EngineConfig) -> int:
    """Unplayed frames below which the next window is made: a longer look-ahead must be filled."""
    return max(config.continue_threshold, spec.lookahead - facts.horizon)
