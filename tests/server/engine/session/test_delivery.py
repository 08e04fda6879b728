import math

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.delivery import Delivery
from motiongen_server.engine.session.playback import PlaybackClock, RoundTrip
from motiongen_server.engine.types import Playhead, SessionKey

KEY = SessionKey(1, 1)


def playing_at(frame: int, at: float) -> Delivery:
    delivery = Delivery(KEY, 40, EngineConfig(), PlaybackClock(20), RoundTrip(0.05), sent_to=80)
    delivery.report(Playhead(KEY, 0, at, frame, 80, 0))
    return delivery


@pytest.mark.parametrize("lead_s", [0.0, 0.05, 0.07, 0.17, 0.2, 0.233])
def test_no_frame_is_replaced_that_a_client_may_be_showing_by_then(lead_s: float) -> None:
    # who reports frame 10 is anywhere from its beginning up to, not including, frame 11
    shown_at_last = math.floor(10.999 + 20 * lead_s)
    assert playing_at(10, 100.0).unshown_from(100.0, lead_s) == shown_at_last + 1


def test_no_frame_is_replaced_that_was_shown_while_nobody_reported() -> None:
    delivery = playing_at(10, 100.0)
    assert [delivery.unshown_from(100.0 + wait_s, 0.1) for wait_s in (0.01, 0.05, 1.0)] == [14, 14, 33]
    assert delivery.unshown_from(200.0, 0.1) == 83, "it waits at the end of what it was sent"
