"""How much of a quota of processor time goes with an engine's own calls."""

import pytest

from motiongen_server.engine.scheduling.quota_share import QuotaAccount, QuotaShare

EVERY_S = 0.25


class Group:
    """A control group of processes, of which one is an engine's."""

    def __init__(self, cores: float = 1.0, engines: int = 1) -> None:
        self.used_s = 100.0  # from before
        self.share = QuotaShare(QuotaAccount(cores, engines, lambda: self.used_s, lambda: 0.0))

    def pass_by(self, seconds: float, used: float, spent: float) -> float:
        """The factor after so many seconds. used: part of the quota in use; spent: load of the engine's calls."""
        for _ in range(round(seconds / EVERY_S)):
            self.used_s += used * EVERY_S
            self.share.update(EVERY_S, spent)
        return self.share.factor


@pytest.mark.parametrize(
    ("cores", "engines", "used", "spent", "factor"),
    [
        (1.5, 2, 0.6, 0.4, 1.5),  # two engines and a gateway, none of them stalled
        (1.5, 2, 1.0, 0.7, 1.43),  # the quota is used up and all stall: the factor is hardly different
        (0.7, 1, 1.0, 0.6, 1.67),
        (1.0, 1, 1.0, 1.0, 1.0),  # nothing but the engine
        (4.0, 1, 0.225, 0.85, 0.265),  # of four cores, an engine of one thread; or of sixteen, one of four
        (4.0, 1, 0.175, 0.85, 0.25),  # no less than what the engine took itself
        (0.2, 1, 0.8, 0.15, 5.0),  # nor with a small quota, of which a second of calls is five times as much
        (1.0, 1, 0.9, 0.1, 4.0),  # other processes work not only for the sessions of this engine
    ],
)
def test_factor_is_the_quota_used_per_second_of_calls_within_bounds(
    cores: float, engines: int, used: float, spent: float, factor: float
) -> None:
    assert Group(cores, engines).pass_by(120.0, used, spent) == pytest.approx(factor, rel=0.01)


@pytest.mark.parametrize(
    ("cores", "engines", "factor"), [(1.0, 1, 1.1), (1.5, 2, 1.47), (0.7, 1, 1.57), (2.0, 1, 0.55)]
)
def test_engines_are_assumed_equally_busy_before_any_measurement(cores: float, engines: int, factor: float) -> None:
    group = Group(cores, engines)
    assert group.pass_by(60.0, used=0.2, spent=0.01) == pytest.approx(factor, rel=0.01)


def test_gateway_load_of_opening_sessions_counts_little_for_the_factor() -> None:
    group = Group()
    opening = group.pass_by(2.0, used=0.4, spent=0.2)
    assert 1.05 < opening < 1.1 + 0.25 * 0.9
    assert group.pass_by(120.0, used=0.88, spent=0.8) == pytest.approx(1.1, rel=0.01)


def test_factor_is_kept_while_an_engine_is_idle() -> None:
    group = Group()
    busy = group.pass_by(60.0, used=0.75, spent=0.5)
    assert group.pass_by(60.0, used=0.3, spent=0.0) == busy


def test_quota_used_before_the_start_does_not_count() -> None:
    assert Group().pass_by(60.0, used=0.4, spent=0.4) == pytest.approx(1.0, rel=0.01)


def test_observations_change_the_factor_gradually() -> None:
    group = Group()
    before = group.share.factor
    group.pass_by(8.0, used=0.0, spent=0.0)
    group.used_s += 3.0 * EVERY_S
    group.share.update(EVERY_S, 0.25)
    seen = 3.0 * EVERY_S / 2.0 / 0.25  # an eighth of the newest use counts at once
    assert group.share.factor == pytest.approx(before + EVERY_S / 16.0 * (seen - before))
    once = Group()
    once.used_s += 60.0
    once.share.update(60.0, 0.5)
    assert once.share.factor == pytest.approx(2.0), "all of it counts after a minute"
