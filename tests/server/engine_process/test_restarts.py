"""How long it takes until a lost engine process is replaced."""

from __future__ import annotations

from motiongen_server.engine_process.restarts import BACK_OFF_S, LOSSES, LOSSES_WITHIN_S, Restarts


def test_first_loss_is_replaced_at_once_and_further_ones_after_a_delay() -> None:
    restarts = Restarts(rest_s=7.0)
    assert [restarts.lose(at) for at in (100.0, 101.0, 102.0, 110.0)] == [0.0, BACK_OFF_S, 7.0, 7.0]
    assert restarts.has_failed(110.0)
    assert restarts.count == 4


def test_losses_long_ago_do_not_count() -> None:
    restarts = Restarts()
    assert [restarts.lose(number * LOSSES_WITHIN_S) for number in range(2 * LOSSES)] == [0.0] * 2 * LOSSES
    assert not restarts.has_failed(2 * LOSSES * LOSSES_WITHIN_S)
