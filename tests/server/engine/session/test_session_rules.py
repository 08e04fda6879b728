"""Random events against the rules: whatever clients do and however long steps take, no viewer sees a rule broken."""

import math

import hypothesis.strategies as st
import numpy as np
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.levels import FULL, Level
from motiongen_server.engine.session import planning
from motiongen_server.engine.types import (
    Code,
    PlanCause,
    Priority,
    RootTrajectory,
    ServiceTier,
    SessionKey,
    StartPose,
    Waypoint,
    WindowJob,
)
from tests.server.engine.fakes import PROMPT
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

HANDLES = st.integers(1, 4)
# the markers of prompts that may start later than one for now, and are then in force instead of it
SCHEDULED = {2, *range(12, 17)}


LEVELS = (
    FULL,
    Level(ServiceTier.FEWER_STEPS, steps=2, full_stride=True, replan_cap_scale=0.5),
    Level(ServiceTier.NO_GUIDANCE, steps=2, drop_guidance=True),
    Level(ServiceTier.HOLD, hold=True),
)


class SessionRules(RuleBasedStateMachine):
    """The viewers check every output as it comes; here it remains to check that nothing is left unanswered."""

    @initialize(
        max_rows=st.integers(1, 4),
        base_s=st.floats(0.001, 0.08),
        spread=st.floats(1.0, 8.0),
        seed=st.integers(0, 2**16),
        max_restarts=st.integers(0, 3),
        align_within=st.sampled_from((0, 16, 10_000)),
    )
    def set_the_stage(
        self, max_rows: int, base_s: float, spread: float, seed: int, max_restarts: int, align_within: int
    ) -> None:
        self.stage = Stage(
            EngineConfig(
                max_rows=max_rows,
                max_restarts=max_restarts,
                max_prompts=5,
                align_within=align_within,
                max_waiting_edits=1000,
                degrade=False,
            )
        )
        self.stage.runner.holds = self.stage.runner.rights = True
        self.stage.runner.moves = self._move
        self.lost_plans: set[int] = set()
        random = np.random.default_rng(seed)
        self.stage.runner.step_s = lambda rows: float(base_s * random.uniform(1.0, spread))
        self.now_prompts: dict[int, list[tuple[int, int]]] = {}
        self.last_cuts: dict[SessionKey, tuple[int, int]] = {}  # the event, and how many plans were announced before it
        self.gone: list[Viewer] = []

    def _move(self, job: WindowJob, frames: np.ndarray) -> None:
        """Windows of some plans leave the ground."""
        if job.plan in self.lost_plans:
            frames[20:, 1] = 50.0

    def _viewer(self, handle: int) -> Viewer | None:
        viewer = next((held for held in self.stage.viewers.values() if held.key.handle == handle), None)
        return None if viewer is None or viewer.closed is not None or viewer.opened is None else viewer

    @rule(
        handle=HANDLES,
        priority=st.sampled_from(Priority),
        lookahead=st.integers(20, 80),
        num_steps=st.integers(2, 10),
        later=st.none() | st.integers(1, 90),
    )
    def open(self, handle: int, priority: Priority, lookahead: int, num_steps: int, later: int | None) -> None:
        if any(held.key.handle == handle and held.closed is None for held in self.stage.viewers.values()):
            return
        self.gone += [held for held in self.stage.viewers.values() if held.key.handle == handle]
        prompts = [prompt(1, 1, 0)] + ([prompt(2, 2, later)] if later else [])
        self.stage.open(
            handle, priority=priority, lookahead=lookahead, num_steps=num_steps, prompts=tuple(prompts), seed=handle
        )
        self.now_prompts[handle] = []
        self.last_cuts.pop(SessionKey(1, handle), None)
        self.stage.step()

    @rule(handle=HANDLES, marker=st.integers(3, 9))
    def set_prompt_for_now(self, handle: int, marker: int) -> None:
        if viewer := self._viewer(handle):
            seq = self.stage.set_prompts(viewer, prompt(marker, prompt_id=1))
            self.now_prompts[handle].append((seq, marker))

    @rule(
        handle=HANDLES, prompt_id=st.integers(2, 6), ahead=st.integers(-20, 90), length=st.none() | st.integers(1, 60)
    )
    def set_prompt_for_later(self, handle: int, prompt_id: int, ahead: int, length: int | None) -> None:
        if viewer := self._viewer(handle):
            start = max(0, viewer.shown + ahead)
            end = None if length is None else start + length
            self.stage.set_prompts(viewer, prompt(10 + prompt_id, prompt_id, start, end))
            self.now_prompts[handle].clear()

    @rule(handle=HANDLES, prompt_id=st.integers(2, 6))
    def remove_prompt(self, handle: int, prompt_id: int) -> None:
        if viewer := self._viewer(handle):
            self.stage.set_prompts(viewer, remove=(prompt_id,))

    @rule(handle=HANDLES, ids=st.lists(st.integers(1, 5), max_size=3), ahead=st.integers(-10, 300), path=st.booleans())
    def set_constraints(self, handle: int, ids: list[int], ahead: int, path: bool) -> None:
        if viewer := self._viewer(handle):
            frame = max(0, viewer.shown + ahead)
            targets = [
                RootTrajectory(n, frame, np.zeros((30, 2), np.float32)) if path else Waypoint(n, frame + n, 0.0, 1.0)
                for n in ids
            ]
            self.stage.set_constraints(viewer, *targets)

    @rule(handle=HANDLES, remove=st.lists(st.integers(1, 5), max_size=2), clear=st.booleans())
    def remove_constraints(self, handle: int, remove: list[int], clear: bool) -> None:
        if viewer := self._viewer(handle):
            self.stage.set_constraints(viewer, remove=() if clear else tuple(remove), clear=clear)

    @rule(
        handle=HANDLES,
        x=st.floats(-3, 3),
        heading=st.none() | st.floats(-4, 4),
        hold_frames=st.integers(1, 100),
        again=st.booleans(),
    )
    def set_velocity(self, handle: int, x: float, heading: float | None, hold_frames: int, again: bool) -> None:
        if viewer := self._viewer(handle):
            for _ in range(1 + again):
                self.stage.set_velocity(viewer, x, 0.0, heading, hold_frames)

    @rule(handle=HANDLES, x=st.floats(-50, 50))
    def put_elsewhere(self, handle: int, x: float) -> None:
        if viewer := self._viewer(handle):
            self.last_cuts[viewer.key] = self.stage.seek(viewer, StartPose(x, 0.0, 0.0)), len(viewer.notices)

    @rule(
        handle=HANDLES,
        priority=st.none() | st.sampled_from(Priority),
        lookahead=st.none() | st.integers(20, 80),
        num_steps=st.none() | st.integers(2, 10),
    )
    def change_options(
        self, handle: int, priority: Priority | None, lookahead: int | None, num_steps: int | None
    ) -> None:
        if viewer := self._viewer(handle):
            viewer.lookahead = max(viewer.lookahead, lookahead or 0)
            self.stage.set_options(viewer, priority=priority, lookahead=lookahead, denoise_steps=num_steps)

    @rule(handle=HANDLES, level=st.sampled_from(LEVELS))
    def change_service_level(self, handle: int, level: Level) -> None:
        if viewer := self._viewer(handle):
            self._set_level(viewer, level)

    def _set_level(self, viewer: Viewer, level: Level) -> None:
        engine = self.stage.engine
        state = engine.sessions[viewer.key]
        self.stage.deliver(state.set_tier(level))
        engine.sessions.touch(state)

    @rule(handle=HANDLES, rtt_s=st.none() | st.floats(-1, 2))
    def change_round_trip(self, handle: int, rtt_s: float | None) -> None:
        if viewer := self._viewer(handle):
            viewer.rtt_s = rtt_s

    @rule(plans=st.sets(st.integers(2, 40), max_size=3))
    def lose_characters(self, plans: set[int]) -> None:
        self.lost_plans = plans

    @rule(handle=HANDLES, silent=st.booleans())
    def fall_silent_or_talk_again(self, handle: int, silent: bool) -> None:
        if viewer := self._viewer(handle):
            (self.stage.silent.add if silent else self.stage.silent.discard)(viewer.key)

    @rule(handle=HANDLES, frame=st.integers(0, 300) | st.just(2**63))
    def report_nonsense(self, handle: int, frame: int) -> None:
        if viewer := self._viewer(handle):
            self.stage.engine.submit(viewer.lie(frame, self.stage.clock.now()))

    @rule(handle=HANDLES, paused=st.booleans())
    def pause_or_play(self, handle: int, paused: bool) -> None:
        if viewer := self._viewer(handle):
            self.stage.pause(viewer, paused)

    @rule(handle=HANDLES)
    def close(self, handle: int) -> None:
        if viewer := self._viewer(handle):
            self.stage.close(viewer)
            self.stage.step()
            assert viewer.closed is not None

    @rule(seconds=st.floats(0.001, 2.0))
    def let_time_pass(self, seconds: float) -> None:
        self.stage.run(seconds)

    @precondition(lambda self: hasattr(self, "stage"))
    @rule(steps=st.integers(1, 5))
    def step(self, steps: int) -> None:
        for _ in range(steps):
            self.stage.step()

    @invariant()
    def the_contract_with_the_runner_is_kept(self) -> None:
        if hasattr(self, "stage"):
            assert self.stage.runner.breaches == []
            self._check_states()
            owners = self.stage.engine.windows.owners
            assert set(self.stage.runner.jobs) <= set(owners)
            assert len(owners) <= self.stage.engine.num_sessions

    def _check_states(self) -> None:
        """What must hold of every session between any two events."""
        for state in self.stage.engine.sessions:
            delivery = state.delivery
            assert delivery.sent_to <= state.planned_to
            widest = self.stage.viewers[state.key].lookahead  # frames stay sent when the look-ahead becomes shorter
            assert delivery.sent_to <= max(delivery.clock.reported + widest, 0)
            assert delivery.committed_to <= state.planned_to
            assert state.timeline.first <= max(0, delivery.committed_to - state.config.history_crop)
            assert state.timeline.run.end <= state.planned_to
            if state.running is not None:
                assert state.running.first_frame < state.running.accept_to
                assert state.running.first_frame <= state.planned_to
            due = planning.window_due(state, self.stage.clock.now())
            assert due or planning.wake_at(state) > -math.inf, "nothing is due, yet the session wakes at once"

    def teardown(self) -> None:
        if not hasattr(self, "stage"):
            return
        stage = self.stage
        stage.silent.clear()
        for viewer in stage.viewers.values():
            if viewer.closed is None and viewer.opened is not None:
                stage.pause(viewer, False)
                self._set_level(viewer, FULL)
        stage.runner.step_s = lambda rows: 0.005
        stage.run(8.0)
        stage.check_finished()
        for viewer in self.gone:
            assert viewer.outcomes.keys() == viewer.asked
        for viewer in stage.viewers.values():
            self._check_last_prompt(viewer)
            self._check_last_cut(viewer)

    def _check_last_cut(self, viewer: Viewer) -> None:
        """A session whose last cut was accepted gets a plan for it."""
        seq, told = self.last_cuts.get(viewer.key, (0, 0))
        if seq and viewer.closed is None and viewer.outcomes[seq].code is Code.OK:
            assert any(notice.cause is PlanCause.CUT for notice in viewer.notices[told:])

    def _check_last_prompt(self, viewer: Viewer) -> None:
        """A prompt for now that no later one follows holds from its effective frame to the end."""
        asked = self.now_prompts[viewer.key.handle]
        if viewer.closed is not None or not asked:
            return
        seq, marker = asked[-1]
        outcome = viewer.outcomes[seq]
        assert outcome.code is Code.OK
        if outcome.effective_frame is not None:
            held = {int(row[PROMPT]) for row in viewer.rows[outcome.effective_frame :]}
            assert held <= {marker, *SCHEDULED}


SessionRules.TestCase.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
TestSessionRules = SessionRules.TestCase
