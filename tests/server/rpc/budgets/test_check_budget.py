"""Checks of signed tokens: a flood of invalid ones is refused, and no other caller, not even of the same address."""

from __future__ import annotations

import contextlib

import pytest

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.budgets.check_budget import CHARACTERS_A_CHECK, CHECKS_PER_SECOND, CheckBudget

FLOOD, OTHER = "ipv4:10.0.0.7:1001", "ipv4:10.0.0.7:1002"
SHORT, LONG = 512, 7 * 1024


class Checks:
    """A budget, with a clock that tests move."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.budget = CheckBudget(lambda: self.now)

    def failing(self, peer: str, times: int, num_characters: int = SHORT) -> int:
        """Shows that many invalid tokens; returns how many were checked."""
        looked_at = 0
        for _ in range(times):
            with contextlib.suppress(StreamRefused):
                self.budget.charge(peer, num_characters)
                looked_at += 1
        return looked_at

    def holding(self, peer: str) -> None:
        """Shows a valid token. Raises StreamRefused."""
        self.budget.charge(peer, SHORT)()


def test_checks_of_invalid_tokens_are_limited_more_so_for_long_ones() -> None:
    checks = Checks()
    assert checks.failing(FLOOD, 5_000) <= CHECKS_PER_SECOND
    checks = Checks()
    assert checks.failing(FLOOD, 5_000, LONG) <= CHECKS_PER_SECOND / 8 + 1
    for _ in range(100):  # ten seconds
        checks.now += 0.1
        assert checks.failing(FLOOD, 500, LONG) <= CHECKS_PER_SECOND / 80 + 1


def test_caller_in_debt_is_told_when_to_show_its_token_again() -> None:
    checks = Checks()
    checks.failing(FLOOD, 5_000)
    with pytest.raises(StreamRefused, match="send yours again in") as refused:
        checks.holding(FLOOD)
    assert (refused.value.code.name, refused.value.reason) == ("RESOURCE_EXHAUSTED", "TOO_MANY_CALLS")
    checks.now += refused.value.retry_after_s
    checks.holding(FLOOD)


def test_valid_tokens_are_free() -> None:
    checks = Checks()
    for _ in range(20_000):
        checks.holding(FLOOD)


@pytest.mark.parametrize("other", [OTHER, "ipv4:10.0.0.8:1001"], ids=["same address", "another"])
def test_tokens_of_others_are_checked_during_a_flood(other: str) -> None:
    checks = Checks()
    for _ in range(100):
        checks.failing(FLOOD, 1_000)
        checks.holding(other)
        checks.now += 0.05


def test_flood_from_many_addresses_leaves_another_address_its_part() -> None:
    checks = Checks()
    for _ in range(20):
        for number in range(50):
            checks.failing(f"ipv4:10.1.0.{number}:1", 100)
        checks.holding(OTHER)
        checks.now += 0.05


def test_checks_of_all_addresses_together_are_bounded() -> None:
    checks, peers = Checks(), [f"ipv4:10.1.{number}.1:1" for number in range(50)]
    looked_at = 0
    for _ in range(100):  # ten seconds
        looked_at += sum(checks.failing(peer, 100) for peer in peers)
        checks.now += 0.1
    assert looked_at <= (10 + 1) * CHECKS_PER_SECOND + len(peers)


def test_connections_that_show_no_more_tokens_are_forgotten() -> None:
    checks = Checks()
    for number in range(10_000):
        checks.now += 0.02
        checks.failing(f"ipv4:10.0.{number % 250}.7:{number}", 1)
    assert len(checks.budget._connections) < 250
    assert len(checks.budget._addresses) < 250


def test_connections_of_an_address_have_equal_parts_of_its_checks() -> None:
    checks, looked_at = Checks(), [0, 0]
    for _ in range(100):  # ten seconds
        for index, peer in enumerate((FLOOD, OTHER)):
            looked_at[index] += checks.failing(peer, 500)
        checks.now += 0.1
    most = (10 + 1) * CHECKS_PER_SECOND / (1 + SHORT / CHARACTERS_A_CHECK)
    assert 0.95 * most <= sum(looked_at) <= 1.05 * most
    assert min(looked_at) > 0.4 * sum(looked_at)
