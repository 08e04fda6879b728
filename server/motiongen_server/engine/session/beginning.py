"""Begins the session of an Open: a new one, or one that another engine had."""

from __future__ import annotations

from collections.abc import Callable

from motiongen_server.engine.session.events import apply
from motiongen_server.engine.session.opening import Opening, open_session
from motiongen_server.engine.session.snapshot import check_usable, going_on
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import Float32Array, Open, Output, Resume
from motiongen_server.engine.types.refusals import prior_frames_failed
from motiongen_server.engine.types.report import StepReport

MakeFeatures = Callable[[Float32Array], Float32Array | None]
"""Makes features (T, D) of rows (T, row_width); None if the model fails on them."""


def begun(event: Open, opening: Opening, features_of: MakeFeatures) -> SessionState:
    """The session of an Open. Raises EventRefused if it cannot be opened or continued."""
    asked = event.going_on
    if asked is not None:
        check_usable(asked, opening.facts)
    rows = event.spec.prior_rows if asked is None else asked.snapshot.rows
    if rows is None:
        return open_session(event.spec, event.received_at, opening)
    features = features_of(rows)
    if features is None:
        raise prior_frames_failed("open.prior_frames")
    if asked is None:
        return open_session(event.spec, event.received_at, opening, features)
    return going_on(event, asked, opening, features)


def first_words(state: SessionState, event: Open, now: float, report: StepReport) -> list[Output]:
    """The first outputs for its client; a session from another engine continues as if it had been resumed here."""
    asked = event.going_on
    if asked is None:
        return [state.greeting()]
    resume = Resume(event.session, 0, event.received_at, asked.attempt, asked.next_frame, asked.plan)
    return [state.greeting(), *apply(state, resume, now, report)]
