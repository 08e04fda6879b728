"""The queue of control messages for an engine process, and what becomes of models when processes are lost."""

from __future__ import annotations

from motiongen_server.engine.types import CloseReason, ModelFacts
from motiongen_server.engine_process.control import ControlQueue
from motiongen_server.engine_process.messages import EncodeTexts, Load, LoadEncoder, Ready, Stop, ToEngine, Unload
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.rpc.abilities import NOTHING_CLAIMED
from tests.server.engine.fakes import FACTS


def link_of(slot: int) -> ModelLink:
    return ModelLink(slot, f"model-{slot}", lambda outputs: None, lambda: None)


def loaded(link: ModelLink, facts: ModelFacts = FACTS) -> ModelLink:
    link.take_ready(Ready(link.slot, facts, "CC0-1.0", NOTHING_CLAIMED))
    return link


def queue_of(*links: ModelLink) -> ControlQueue:
    queue = ControlQueue()
    assert all(queue.add(link) for link in links)
    return queue


def test_load_and_unload_of_a_model_are_sent_once() -> None:
    link = link_of(1)
    queue = queue_of(link)
    assert queue.is_loading
    assert queue.take() == (Load(1, "model-1"),)
    loaded(link)
    assert not queue.is_loading
    assert queue.retire(link)
    assert (queue.take(), queue.take()) == ((Unload(1),), ())


def test_next_process_is_told_to_load_models_and_encoder_again() -> None:
    first, second = link_of(1), link_of(2)
    queue = queue_of(first, second)
    told: list[ToEngine] = [LoadEncoder(8)]
    queue.serve_text(lambda: told)
    queue.tell(EncodeTexts(1, ("walk",)))
    assert queue.begin() == []
    assert queue.take() == (Load(1, "model-1"), Load(2, "model-2"), LoadEncoder(8), EncodeTexts(1, ("walk",)))
    assert queue.begin() == []
    assert queue.take() == (Load(1, "model-1"), Load(2, "model-2"), LoadEncoder(8))


def test_lost_process_drops_models_never_loaded_or_being_unloaded() -> None:
    held, given_up, never_loaded = loaded(link_of(1)), loaded(link_of(2)), link_of(3)
    queue = queue_of(held, given_up, never_loaded)
    assert queue.retire(given_up)
    assert queue.lose() == [given_up, never_loaded]
    assert (list(queue), queue.take()) == ([held], ())


def test_model_being_loaded_when_a_process_was_lost_is_loaded_last() -> None:
    """If loading it hung or crashed again, the models behind it would never be loaded."""
    first, second, third = (loaded(link_of(slot)) for slot in (1, 2, 3))
    queue = queue_of(first, second, third)
    assert queue.lose() == []
    for link in queue:
        link.lose(CloseReason.ENGINE_FAULT, "it was killed")
    queue.begin()
    assert queue.take() == (Load(1, "model-1"), Load(2, "model-2"), Load(3, "model-3")), "all had been loaded"
    loaded(first)
    assert queue.lose() == []
    queue.begin()
    assert queue.take() == (Load(1, "model-1"), Load(3, "model-3"), Load(2, "model-2"))


def test_model_retired_while_there_is_no_process_is_gone_at_once() -> None:
    link = link_of(1)
    queue = queue_of(link)
    assert not queue.retire(link)
    assert list(queue) == []
    assert queue.get(1) is None


def test_absent_model_is_loaded_again_unless_it_was_retired() -> None:
    absent, given_up = loaded(link_of(1)), loaded(link_of(2))
    queue = queue_of(absent, given_up)
    for link in (absent, given_up):
        link.lose(CloseReason.ENGINE_FAULT, "it was killed")
        link.is_absent = True
    queue.take()
    queue.retire(given_up)
    for slot in (1, 2):
        queue.load_again(slot)
    assert queue.take() == (Load(1, "model-1"),)
    assert not absent.is_absent


def test_stopped_or_closed_queue_accepts_no_more_models() -> None:
    queue = queue_of(link_of(1))
    queue.stop()
    assert not queue.add(link_of(2))
    queue.begin()
    assert queue.take()[-1] == Stop(), "a process that is just starting is told to stop, too"
    ended = queue_of(link_of(1))
    assert [link.slot for link in ended.close()] == [1]
    assert not ended.add(link_of(2))
