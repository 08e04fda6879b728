"""Frames wait until there are enough of them for a message, as long as a client has enough to play."""

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Chunk
from tests.server.engine.session.playing import playing, waypoint
from tests.server.engine.stage import Stage, prompt

LOOKAHEAD = 40
LOW = 15


def sends_of(stage: Stage, seconds: float) -> tuple[int, int]:
    """How often frames were sent within so many seconds, and how many of them, once playback is under way."""
    delivered: list[int] = []
    deliver = stage.deliver
    stage.deliver = lambda outputs: (  # type: ignore[method-assign]
        delivered.append(sum(len(output.rows) for output in outputs if isinstance(output, Chunk))),
        deliver(outputs),
    )[1]
    stage.run(seconds)
    return sum(frames > 0 for frames in delivered), sum(delivered)


@pytest.mark.parametrize("report_every_s", [0.05, 0.1, 0.2, 0.25, 0.5])
def test_frames_are_sent_in_large_parts_however_often_a_playhead_is_reported(report_every_s: float) -> None:
    stage = Stage(report_every_s=report_every_s)
    viewer = stage.open()
    stage.run(5.0)
    sends, frames = sends_of(stage, 60.0)
    assert frames == pytest.approx(60 * 20, abs=LOOKAHEAD)
    assert frames / sends > 16, "a window of 40 frames is sent in two parts or a little more"
    assert viewer.underruns == 0
    stage.check_finished()


@pytest.mark.parametrize("report_every_s", [0.1, 0.25, 0.4, 0.5, 1.0])
def test_client_has_enough_to_play_while_frames_wait(report_every_s: float) -> None:
    stage = Stage(report_every_s=report_every_s)
    viewer = stage.open()
    stage.run(5.0)
    left = []
    for _ in range(600):
        stage.run(0.1)
        left.append(viewer.buffered_to - viewer.position)
    # Frames beyond the credit may not be sent; those within it wait until so few are left.
    assert min(left) >= min(LOW, LOOKAHEAD - 20 * report_every_s) - 2
    assert viewer.underruns == 0


@pytest.mark.parametrize("silent_after_s", [0.1 * n for n in range(22)])
def test_silent_client_gets_the_waiting_frames_after_some_time(silent_after_s: float) -> None:
    stage = Stage(report_every_s=0.25)
    viewer = stage.open()
    stage.run(5.0 + silent_after_s)
    stage.silent.add(viewer.key)
    stage.run(10.0)
    assert viewer.buffered_to == viewer.reported + LOOKAHEAD


@pytest.mark.parametrize("paused_after_s", [0.1 * n for n in range(22)])
def test_no_frames_wait_while_playback_is_paused(paused_after_s: float) -> None:
    stage = Stage(report_every_s=0.25)
    viewer = stage.open()
    stage.run(5.0 + paused_after_s)
    stage.pause(viewer, True)
    stage.run(1.0)
    assert viewer.buffered_to == min(viewer.reported + LOOKAHEAD, stage.engine.sessions[viewer.key].planned_to)


@pytest.mark.parametrize("frame", range(100, 140, 3))
def test_waiting_frames_do_not_delay_reports_of_constraints(frame: int) -> None:
    told = []
    for config in (EngineConfig(), EngineConfig(steady_chunk=1)):
        stage = Stage(config, report_every_s=0.25)
        viewer = stage.open(constraints=(waypoint(frame),))
        stage.run_until(lambda viewer=viewer: len(viewer.reached) > 0)  # type: ignore[misc]
        told.append(stage.clock.now())
    assert told[0] == pytest.approx(told[1], abs=0.002)


@pytest.mark.parametrize("rtt_s", [0.05, 0.4, 0.9])
def test_frames_of_an_edit_are_sent_at_once_even_to_a_distant_client(rtt_s: float) -> None:
    stage, viewer = playing()
    viewer.rtt_s = rtt_s  # the further away, the later the change begins, and the less of it the credit covers
    stage.run(2.0)
    sent_before = len(viewer.chunks)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run_until(lambda: seq in viewer.outcomes)
    stage.run_until(lambda: viewer.notices[-1].event_seqs == (seq,))
    assert viewer.chunks[-1].plan == viewer.notices[-1].plan
    assert len(viewer.chunks[sent_before].rows) <= 8
    assert viewer.buffered_to == min(stage.engine.sessions[viewer.key].planned_to, viewer.reported + LOOKAHEAD)
