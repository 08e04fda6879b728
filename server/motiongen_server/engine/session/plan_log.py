"""PlanLog: the plans that a client may not have heard of, to tell it when it resumes after losing its connection."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen_server.engine.types import AnnouncedPlan, PlanNotice

MAX_TOLD_EVENTS = 64


class PlanLog:
    """Plans in order, with valid_from rising: a plan takes the place of those that it replaces entirely.

    A plan is removed once the client reports a frame that was sent in it or after it. So at most one is held for each
    frame from the playhead to the end of the plan.
    """

    def __init__(self, plans: Iterable[AnnouncedPlan] = ()) -> None:
        self._plans = list(plans)

    @property
    def plans(self) -> tuple[AnnouncedPlan, ...]:
        """All that are held, in order."""
        return tuple(self._plans)

    def __len__(self) -> int:
        return len(self._plans)

    def note(self, notice: PlanNotice, sent_to: int) -> None:
        """A plan is announced. sent_to: the end of the frames sent before, including those that it replaces."""
        seqs = notice.event_seqs
        while self._plans and self._plans[-1].valid_from >= notice.valid_from:
            outdone = self._plans.pop()
            sent_to, seqs = max(sent_to, outdone.sent_to), (outdone.event_seqs + seqs)[-MAX_TOLD_EVENTS:]
        self._plans.append(AnnouncedPlan(notice.plan, notice.valid_from, sent_to, seqs))

    def confirm(self, playhead: int) -> None:
        """The client shows this frame, so it has heard of every plan without which it could not have the frame."""
        known = 0
        while known < len(self._plans) and self._plans[known].sent_to < playhead:
            known += 1
        if known:
            del self._plans[:known]

    def missed(self, plan: int, next_frame: int) -> tuple[int, tuple[int, ...]]:
        """What a client has missed that knows plans up to `plan` and holds frames below next_frame.

        Returns the first frame that a newer plan replaces, next_frame if there is none, and the events that first take
        effect in these plans.
        """
        missed = [each for each in self._plans if each.plan > plan]
        if not missed:
            return next_frame, ()
        return missed[0].valid_from, tuple(seq for each in missed for seq in each.event_seqs)[-MAX_TOLD_EVENTS:]
