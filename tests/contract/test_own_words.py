"""How our server words `allowed`; the compliance suite leaves the wording to each server."""

from __future__ import annotations

import pytest

from motiongen_compliance.messages import addressed
from motiongen_compliance.mistakes import Mistake, check
from motiongen_compliance.suite.test_wrong_edits import REFUSED_EDITS
from motiongen_compliance.suite.test_wrong_opens import REFUSED_OPENS
from motiongen_compliance.target import Target


@pytest.mark.parametrize("mistake", REFUSED_EDITS, ids=lambda mistake: mistake.name)
async def test_refused_edit_says_what_is_allowed(local: Target, mistake: Mistake) -> None:
    talk = await local.talk()
    await talk.open(1)
    outcome = await talk.edit(1, mistake.make(local.catalog))
    check(outcome, mistake)
    assert mistake.allowed in outcome.allowed


@pytest.mark.parametrize("mistake", REFUSED_OPENS, ids=lambda mistake: mistake.name)
async def test_refused_open_says_what_is_allowed(local: Target, mistake: Mistake) -> None:
    talk = await local.talk()
    await talk.send(addressed(mistake.make(local.catalog), 9, 1))
    await talk.until(lambda: 9 in talk.sessions)
    outcome = await talk.answer(9, 1)
    check(outcome, mistake)
    assert mistake.allowed in outcome.allowed


async def test_wrong_handle_or_number_is_refused_with_what_is_allowed(local: Target) -> None:
    talk = await local.talk()
    await talk.open(1, request_id="mine")
    said = [
        (addressed(REFUSED_OPENS[0].make(local.catalog), 1, 1), 1, "this one after its SessionClosed"),
        (addressed(REFUSED_EDITS[0].make(local.catalog), 33, 1), 33, "send OpenSession first"),
        (addressed(REFUSED_EDITS[0].make(local.catalog), 1, 4), 1, "2"),
        (addressed(REFUSED_EDITS[0].make(local.catalog), 1, 0), 1, "0 for Playhead"),
    ]
    for event, handle, words in said:
        await talk.send(event)
        await talk.until(lambda handle=handle: handle in talk.sessions)  # type: ignore[misc]
        assert words in (await talk.answer(handle, event.event_seq)).allowed
