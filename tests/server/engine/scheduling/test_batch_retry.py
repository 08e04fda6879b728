from collections.abc import Callable, Sequence

import pytest

from motiongen_server.engine.ports import DeviceLost, OutOfMemory
from motiongen_server.engine.scheduling.batch_retry import BatchRetry, CallTime


class Memory:
    """Calls for which at most `room` items fit in memory, but no `large` one; a call with a `broken` item fails."""

    def __init__(
        self,
        room: int = 1000,
        broken: frozenset[int] = frozenset(),
        most: int = 32,
        large: frozenset[int] = frozenset(),
    ) -> None:
        self.room = room
        self.large = large
        self.broken = broken
        self.sizes: list[int] = []
        self.failed: list[tuple[int, Exception]] = []
        self.observed: list[int] = []
        self.attempts: BatchRetry[int, int] = BatchRetry(
            self._call,
            int,
            lambda job_id, error: self.failed.append((job_id, error)),
            lambda items, seconds: self.observed.append(len(items)),
            lambda: CallTime(0.0, 0.0),
            most,
        )

    def _call(self, items: Sequence[int]) -> list[int]:
        self.sizes.append(len(items))
        if len(items) > self.room or self.large & set(items):
            raise OutOfMemory
        if self.broken & set(items):
            raise ValueError
        return [10 * item for item in items]


def test_call_that_succeeds_is_made_once() -> None:
    memory = Memory()
    assert memory.attempts([1, 2, 3]) == [10, 20, 30]
    assert memory.sizes == memory.observed == [3]
    assert memory.attempts([]) == []


def test_call_out_of_memory_is_split_and_later_calls_stay_smaller() -> None:
    memory = Memory(room=5)
    assert memory.attempts(range(20)) == [10 * item for item in range(20)]
    assert memory.sizes == [20, 10, 5, 5, 5, 5]
    assert memory.observed == [5, 5, 5, 5]
    assert memory.attempts.splits == 2
    assert memory.attempts(range(7)) == [10 * item for item in range(7)]
    assert memory.sizes[6:] == [5, 2]
    assert memory.failed == []


def test_calls_grow_again_slowly_once_there_is_memory() -> None:
    memory = Memory(room=5)
    memory.attempts(range(20))
    memory.room = 1000
    for _ in range(100):
        memory.attempts(range(5))
    assert memory.attempts.most == 6
    for _ in range(5000):
        memory.attempts(range(32))
    assert memory.attempts.most == 32


def test_item_that_does_not_fit_even_alone_fails_as_out_of_memory_and_the_others_are_answered() -> None:
    memory = Memory(large=frozenset({3}))
    assert memory.attempts([1, 2, 3, 4, 5]) == [10, 20, 40, 50]
    assert memory.sizes == [5, 2, 2, 1, 1, 1], "and none is tried again"
    ((job_id, error),) = memory.failed
    assert job_id == 3
    assert isinstance(error, OutOfMemory)
    assert (memory.attempts.faults, memory.attempts.splits) == (1, 2)


def test_items_that_all_do_not_fit_fail_each_once() -> None:
    memory = Memory(room=0)
    assert memory.attempts([1, 2]) == []
    assert [job_id for job_id, _ in memory.failed] == [1, 2]
    assert all(isinstance(error, OutOfMemory) for _, error in memory.failed)


def test_item_that_makes_a_call_fail_fails_alone() -> None:
    memory = Memory(broken=frozenset({3}))
    assert memory.attempts([1, 2, 3, 4]) == [10, 20, 40]
    assert [job_id for job_id, _ in memory.failed] == [3]
    assert memory.attempts.faults == 2


@pytest.mark.parametrize("alone", [False, True])
def test_no_call_is_retried_after_the_device_was_lost(alone: bool) -> None:
    memory = Memory(broken=frozenset({3}))
    calls = 0
    inner: Callable[[Sequence[int]], list[int]] = memory._call

    def call(items: Sequence[int]) -> list[int]:
        nonlocal calls
        calls += 1
        if not alone or len(items) == 1:
            raise DeviceLost
        return inner(items)

    memory.attempts._call = call
    with pytest.raises(DeviceLost):
        memory.attempts([1, 3])
    assert calls == (2 if alone else 1)
