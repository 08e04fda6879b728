"""What an engine's own calls stand for under a quota."""

import pytest

from motiongen_server.engine.scheduling.quota_share import QuotaShare


class Account:
    def __init__(self) -> None:
        self.used_s = 100.0  # from before

    def __call__(self) -> float:
        return self.used_s


def share_after(used: float, busy: float, seconds: float = 20.0, every_s: float = 0.25) -> float:
    """The factor where so much of the quota was used, and so much of the time was an engine's."""
    account = Account()
    share = QuotaShare(account)
    for _ in range(round(seconds / every_s)):
        account.used_s += used * every_s
        share.update(every_s, busy)
    return share.factor


@pytest.mark.parametrize(
    ("used", "busy", "factor"),
    [
        (0.6, 0.4, 1.5),  # two engines of 1.5 cores and a gateway, none of them standing still
        (1.0, 1.0, 1.0),  # all stand still: the engine's own calls show it
        (0.7, 0.9, 1.0),  # what it took it did not compute; no other used it
        (0.9, 0.1, 4.0),  # others are at work, not for the sessions of this one alone
        (0.2, 0.01, 1.0),  # nothing to judge by
    ],
)
def test_what_a_second_of_an_engines_calls_stands_for(used: float, busy: float, factor: float) -> None:
    assert share_after(used, busy) == pytest.approx(factor, rel=0.01)


def test_what_was_used_before_does_not_count() -> None:
    assert share_after(used=0.4, busy=0.4, seconds=0.25) == 1.0
