"""SessionState: all that is known of one character, with operations that involve no events, jobs or results."""

from __future__ import annotations

import math
from dataclasses import dataclass

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.levels import FULL, Level
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.cutting import Cut
from motiongen_server.engine.session.delivery import Delivery
from motiongen_server.engine.session.drift import DriftState
from motiongen_server.engine.session.edits import EditQueue
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.session.playback import PlaybackClock
from motiongen_server.engine.session.reach import ReachWatch
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.session.windows import RunningWindow, root_before, steps_at
from motiongen_server.engine.types import (
    Closed,
    CloseReason,
    Code,
    ModelFacts,
    Opened,
    Output,
    Placement,
    PlayState,
    ServiceLevel,
    SessionKey,
    SessionSpec,
)
from motiongen_server.engine.types.refusals import session_closed
from motiongen_server.engine.types.report import StepReport

NOTHING_SAVED = (0, 0)
"""`saved` before the first snapshot: no plan and no answer."""


@dataclass(slots=True)
class SessionState:
    """All that is known of one session. plan: the newest plan's number; holding: the session repeats a pose.

    cut_frames: how many frames to cut from the first window made while the client plays, so that sessions spread out.
    replanned_from: where the last plan began that an edit changed. restarts: how often in a row a running window was
    restarted; extra_lead_s: the longer lead after windows that landed too late. predicted_s: how long the last window
    was expected to take. placements: of the constraints that it was opened with. cut: what its next window continues
    from, if not from its own frames. last_seq: the last event taken. saved: what the last snapshot holds, see
    `snapshot.news_of`.
    """

    spec: SessionSpec
    facts: ModelFacts
    config: EngineConfig
    continue_threshold: int
    cut_frames: int
    conditions: Conditions
    delivery: Delivery
    timeline: Timeline
    edits: EditQueue
    drift_state: DriftState
    reach: ReachWatch
    opened_at: float
    last_playhead_at: float
    moved_at: float
    level: Level = FULL
    plan: int = 0
    running: RunningWindow | None = None
    holding: bool = False
    replanned_from: float = -math.inf
    restarts: int = 0
    extra_lead_s: float = 0.0
    predicted_s: float = 0.0
    underruns: int = 0
    last_seq: int = 1
    saved: tuple[int, int] = NOTHING_SAVED
    placements: tuple[Placement, ...] = ()
    cut: Cut | None = None

    @property
    def key(self) -> SessionKey:
        return self.spec.session

    @property
    def planned_to(self) -> int:
        return self.timeline.end

    @property
    def clock(self) -> PlaybackClock:
        return self.delivery.clock

    @property
    def complete(self) -> bool:
        """Whether this is a clip of which the last frame has been sent."""
        return self.spec.clip_frames is not None and self.delivery.sent_to >= self.spec.clip_frames

    @property
    def num_steps(self) -> int:
        """Denoising steps of the next window."""
        return steps_at(self.level, self.spec, self.facts)

    def num_replan_steps(self, frame: int) -> int:
        """Denoising steps of the next window if it starts at `frame` for the edits that wait.

        Under a velocity that is renewed often, each window is shown for a few frames only; the model may need fewer
        steps there. Everything else that a session asks for, its own prompts included, gets all of them.
        """
        conditions, most = self.conditions, self.num_steps
        follows = self.cut is None and frame - self.replanned_from < self.config.align_within
        if not follows or conditions.constraints or conditions.gait_at(frame) is None:
            return most
        return min(most, max(self.facts.min_steps, math.ceil(self.facts.steered_share * self.spec.denoise_steps)))

    @property
    def idle_at(self) -> float:
        """When the session must be closed if its playhead is not reported, or does not move, until then."""
        config = self.config
        still_s = config.idle_timeout_s if self.clock.state is PlayState.PLAYING else config.still_timeout_s
        return min(self.last_playhead_at + config.idle_timeout_s, self.moved_at + still_s)

    @property
    def replan_wanted(self) -> bool:
        """Whether edits wait, or a lost character waits to be corrected.

        The latter just once while the playhead stands, as the character would be lost at the same frame again and
        again.
        """
        drift = self.drift_state
        return bool(self.edits.waiting) or (drift.lost and (self.clock.running or not drift.tried))

    # ---- opening and closing ----------------------------------------------------------------------------------------

    def greeting(self) -> Opened:
        return Opened(
            self.key,
            self.spec.seed,
            start_frame=0,
            lookahead=self.spec.lookahead,
            committed_horizon=math.ceil(self.facts.fps * self.config.commit_s) + 1,
            denoise_steps=self.spec.denoise_steps,
            model_id=self.facts.model_id,
            rig_id=self.facts.rig.rig_id,
            fps=self.facts.fps,
            placements=self.placements,
        )

    def close(self, reason: CloseReason, code: Code, message: str) -> list[Output]:
        """Answer every edit that still waits, then report the end. The session must not be used afterwards."""
        waiting = (*(self.running.answers if self.running else ()), *self.edits.waiting)
        outputs: list[Output] = [session_closed().outcome(self.key, edit.event_seq) for edit in waiting]
        self.running, self.edits.waiting = None, ()
        return [*outputs, Closed(self.key, reason, code, message, self.delivery.num_frames, self.delivery.late_frames)]

    def set_tier(self, level: Level) -> list[Output]:
        """Set the session's level of service from its next window on. Returns the notice to the client, if any."""
        before = self.level.tier, self.num_steps
        self.level = level
        given = level.tier, self.num_steps
        return [] if given == before else [ServiceLevel(self.key, *given)]

    # ---- leads ------------------------------------------------------------------------------------------------------

    def replaceable_from(self, now: float, lead_s: float) -> int:
        """The first frame not promised that the client cannot be showing lead_s from now; at most planned_to."""
        delivery = self.delivery
        # Fewer frames than a patch make no history, and a window without history would begin at the start pose. A cut
        # may replace the previous one: with frequent cuts each would otherwise begin further ahead than the last.
        cuts = self.cut is not None or (self.running is not None and self.running.cut is not None)
        least = self.timeline.motion_from + (0 if cuts else self.facts.patch)
        return min(max(delivery.committed_to, delivery.unshown_from(now, lead_s), least), self.planned_to)

    def least_start(self, running: RunningWindow) -> int:
        """The first frame at which a window may follow the running one: a patch of motion must precede it."""
        return (running.first_frame if running.fresh else self.timeline.motion_from) + self.facts.patch

    # ---- edits and their window -------------------------------------------------------------------------------------

    def settle(self) -> list[Output]:
        """Answer the edits of frames that no window covers yet: the window that does will take them into account."""
        if self.level.hold:
            return []  # the held pose may extend over those frames
        untouched_from = max(self.planned_to, self.running.accept_to if self.running else 0)
        settled = self.edits.settle(untouched_from)
        return [edit.done(self.key, edit.dirty_from) for edit in settled]

    def withdraw(self, running: RunningWindow, report: StepReport) -> None:
        """Drop the running window; its edits wait again."""
        report.steps_discarded += running.steps_done
        self.edits.put_back(running.answers)
        self.drift_state.correction = running.correction
        self.cut = self.cut or running.cut
        self.running = None

    def advance(self, steps_done: int) -> None:
        """Record the progress of the running window."""
        if self.running is not None:
            self.running.steps_done = steps_done


def anchor_at(state: SessionState, frame: int, cut: Cut | None = None) -> Anchor:
    """The character's state just before a frame that is held, or the end; with a cut there, the cut's."""
    facts, reader, timeline, start = state.facts, state.drift_state.guard.reader, state.timeline, state.spec.start_pose
    if cut is not None:
        timeline, start = cut.timeline_at(frame, facts), cut.start_pose
    return Anchor(frame, root_before(frame, timeline, reader, start, facts.fps), facts.fps, facts.rig)
