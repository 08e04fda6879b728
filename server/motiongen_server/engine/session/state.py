"""SessionState: all that is known of one character, and what does not depend on events, windows or frames."""

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
"""What a snapshot holds that never was: no plan, and no answer."""


@dataclass(slots=True)
class SessionState:
    """All that is known of a session. plan: the newest plan's number; holding: it repeats a pose.

    cut_frames: by which the first window that is made while the client plays is cut, so that sessions spread out.
    replanned_from: where the last plan began that an edit changed. restarts, extra_lead_s: of windows in a row that did
    not land. predicted_s: how long the last one was to take.
    placements: of the constraints that it was opened with. cut: what its next window goes on from, if not from itself.
    last_seq: of the last event that was taken. saved: what the last snapshot holds, see `snapshot.news_of`.
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
        """Whether it is a clip that was sent to its last frame."""
        return self.spec.clip_frames is not None and self.delivery.sent_to >= self.spec.clip_frames

    @property
    def num_steps(self) -> int:
        """Denoising steps of the next window."""
        return steps_at(self.level, self.spec, self.facts)

    def num_replan_steps(self, frame: int) -> int:
        """The same of one for the edits that wait, from a frame on.

        A stick's windows that follow one another closely are shown for a few frames each; the model may do with fewer
        steps there. All else that a session asks for, its own prompts too, gets all of them.
        """
        conditions, most = self.conditions, self.num_steps
        follows = self.cut is None and frame - self.replanned_from < self.config.align_within
        if not follows or conditions.constraints or conditions.gait_at(frame) is None:
            return most
        return min(most, max(self.facts.min_steps, math.ceil(self.facts.steered_share * self.spec.denoise_steps)))

    @property
    def idle_at(self) -> float:
        """When the session is to be closed if its playhead neither is reported nor moves until then."""
        config = self.config
        still_s = config.idle_timeout_s if self.clock.state is PlayState.PLAYING else config.still_timeout_s
        return min(self.last_playhead_at + config.idle_timeout_s, self.moved_at + still_s)

    @property
    def replan_wanted(self) -> bool:
        """Whether edits wait, or a lost character does: once where nothing moves on meanwhile, for it would be lost
        at the same frame again and again."""
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
        """Answer every edit that still waits, then say goodbye. The session must not be used again."""
        waiting = (*(self.running.answers if self.running else ()), *self.edits.waiting)
        outputs: list[Output] = [session_closed().outcome(self.key, edit.event_seq) for edit in waiting]
        self.running, self.edits.waiting = None, ()
        return [*outputs, Closed(self.key, reason, code, message, self.delivery.num_frames, self.delivery.late_frames)]

    def set_tier(self, level: Level) -> list[Output]:
        """Put the session on a level of service, from its next window on; tells the client what changes for it."""
        before = self.level.tier, self.num_steps
        self.level = level
        given = level.tier, self.num_steps
        return [] if given == before else [ServiceLevel(self.key, *given)]

    # ---- leads ------------------------------------------------------------------------------------------------------

    def replaceable_from(self, now: float, lead_s: float) -> int:
        """The first frame that the client cannot be showing lead_s from now, nor was promised; at most planned_to."""
        delivery = self.delivery
        # Fewer frames than a patch make no history, and a window without history would start from the start pose. A cut
        # may take the place of the last one: who goes back and forth would else be farther ahead with each.
        cuts = self.cut is not None or (self.running is not None and self.running.cut is not None)
        least = self.timeline.motion_from + (0 if cuts else self.facts.patch)
        return min(max(delivery.committed_to, delivery.unshown_from(now, lead_s), least), self.planned_to)

    def least_start(self, running: RunningWindow) -> int:
        """The first frame at which a window may follow the running one: there must be a patch of motion before it."""
        return (running.first_frame if running.fresh else self.timeline.motion_from) + self.facts.patch

    # ---- edits and their window -------------------------------------------------------------------------------------

    def settle(self) -> list[Output]:
        """Answer the edits that ask for frames which no window has touched yet: they will be there when it comes."""
        if self.level.hold:
            return []  # it may hold its pose right over those frames
        untouched_from = max(self.planned_to, self.running.accept_to if self.running else 0)
        settled = self.edits.settle(untouched_from)
        return [edit.done(self.key, edit.dirty_from) for edit in settled]

    def withdraw(self, running: RunningWindow, report: StepReport) -> None:
        """Forget the running window; its edits wait again."""
        report.steps_discarded += running.steps_done
        self.edits.put_back(running.answers)
        self.drift_state.correction = running.correction
        self.cut = self.cut or running.cut
        self.running = None

    def advance(self, steps_done: int) -> None:
        """Note how far the running window has come."""
        if self.running is not None:
            self.running.steps_done = steps_done


def anchor_at(state: SessionState, frame: int, cut: Cut | None = None) -> Anchor:
    """What the character does just before a frame that is held, or the end; of a cut there, what it goes on from."""
    facts, reader, timeline, start = state.facts, state.drift_state.guard.reader, state.timeline, state.spec.start_pose
    if cut is not None:
        timeline, start = cut.timeline_at(frame, facts), cut.start_pose
    return Anchor(frame, root_before(frame, timeline, reader, start, facts.fps), facts.fps, facts.rig)
