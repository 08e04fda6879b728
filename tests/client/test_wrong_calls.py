"""Values of wrong types, passed to calls of the client: each is refused by name, and nothing is sent."""

from __future__ import annotations

import asyncio
import math

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import LinePolicy, MotionClient, Session
from motiongen_client.admin import AdminClient
from motiongen_client.errors import InvalidInput
from tests.client.fake_server import FakeServer
from tests.client.line import Line, open_with_frames
from tests.client.synthetic import catalog
from tests.client.waiting import until
from tests.client.wrong_values import (
    ABOVE_0,
    FINE,
    FLAG,
    NO_ITEMS,
    NONE,
    NUMBER,
    PLACE,
    TEXT,
    VALUES,
    WHOLE,
    Made,
    is_refused,
    is_refused_when_awaited,
    name_of,
    taken,
    wrong,
)
from tests.waiting import LIMIT_S

PATH = {"corners_m": set(), "speed_mps": NUMBER | NONE, "smoothing_m": NUMBER | NONE}
CALLS = [
    Made(Session.set_prompt, {"prompt": "walk"}, {"prompt": TEXT, "frame": NONE, "end_frame": NONE, "prompt_id": NONE}),
    Made(Session.remove_prompts, {}, {"prompt_ids": NO_ITEMS}),
    Made(lambda session, value: session.remove_prompts([value]), {}, {"value": WHOLE}),
    Made(
        Session.add_waypoint, {"x_m": 1, "z_m": 1, "frame": 300}, {**PLACE, "frame": WHOLE, "last_frame": NONE}
    ),
    Made(Session.go_to, {"x_m": 1, "z_m": 1}, {**PLACE, "is_relative": FLAG}),
    Made(Session.follow_path, {"corners_m": [[0, 0]]}, PATH),
    Made(
        Session.add_trajectory,
        {"positions_m": [[0, 0]], "first_frame": 300},
        {"positions_m": set(), "first_frame": WHOLE, "headings_rad": {"None", "numbers"}},
    ),
    Made(Session.add_constraints, {}, {"constraints": NO_ITEMS}),
    Made(Session.set_constraints, {}, {"constraints": NO_ITEMS}),
    Made(lambda session, value: session.add_constraints([value]), {}, {"value": set()}),
    Made(
        Session.replace_constraint,
        {"constraint_id": 1, "constraint": FINE},
        {"constraint_id": WHOLE, "constraint": set()},
    ),
    Made(Session.add_heading, {"heading_rad": 1, "frame": 300}, {"heading_rad": NUMBER, "frame": WHOLE}),
    Made(Session.remove_constraints, {}, {"constraint_ids": NO_ITEMS}),
    Made(lambda session, value: session.remove_constraints([value]), {}, {"value": WHOLE}),
    Made(
        Session.set_velocity,
        {"x_mps": 1, "z_mps": 1},
        {
            "x_mps": NUMBER, "z_mps": NUMBER, "seconds": {"float", "negative"}, "heading_rad": NUMBER | NONE,
            "keep_prompt": FLAG,
        },
    ),
    Made(Session.teleport, {"x_m": 1, "z_m": 1}, {"x_m": NUMBER, "z_m": NUMBER, "heading_rad": NUMBER}),
    Made(Session.cut_to, {}, {"prior": set()}),
    Made(Session.seek, {}, {"frame": WHOLE}),
    Made(
        Session.set_options,
        {},
        dict.fromkeys(("priority", "lookahead_frames", "denoise_steps", "guidance", "history_frames"), NONE),
    ),
    Made(lambda session, value: session.set_options(guidance=(value, 1.0)), {}, {"value": NUMBER | NONE}),
    Made(Session.frame_in, {}, {"seconds": NUMBER}),
    Made(Session.set_time_scale, {}, {"scale": ABOVE_0}),
    Made(Session.motion, {"first_frame": 0, "end_frame": 1}, {"first_frame": NONE, "end_frame": NONE}),
]  # fmt: skip


@pytest.mark.parametrize("made", CALLS, ids=name_of)
async def test_values_of_wrong_types_are_refused_by_sessions_and_not_sent(made: Made) -> None:
    line = Line()
    session = await open_with_frames(line)
    session.playback.advance_to(5)
    session.add_waypoint(1.0, 2.0, frame=900)
    said = len(line.said)
    for name, label, arguments in wrong(made):
        assert is_refused(lambda: made.of(session, **arguments)), f"{name} takes {label}"  # noqa: B023  called at once
    assert len(line.said) == said
    for arguments in taken(made):
        is_refused(lambda: made.of(session, **arguments))  # noqa: B023  called at once; the value itself may be invalid
    assert session.set_prompt("a person runs").event_seq == session.last_seq


async def test_waiting_with_an_invalid_id_or_time_is_refused() -> None:
    session = await open_with_frames(Line())
    for label, value in VALUES.items():
        assert await is_refused_when_awaited(lambda: session.constraint_reached(value)), label  # noqa: B023
        if label not in NUMBER | NONE:
            assert await is_refused_when_awaited(lambda: anext(session.frames(value))), label  # noqa: B023
        if label not in FLAG:
            assert await is_refused_when_awaited(lambda: anext(session.frames(realtime=value))), label  # noqa: B023


OPENING = {"prompt": {*TEXT, "None"}, "later_prompts": {"{}"}, "options": NONE, "constraints": NO_ITEMS}


async def test_open_with_wrong_values_is_refused_and_other_sessions_continue(client: MotionClient) -> None:
    """A mistake in an opening must not be found when its answer is read: that would end the stream."""
    other = await client.open("a person walks")
    opening = Made(client.open, {}, {**OPENING, "keep_s": {*ABOVE_0, "None"}})
    later = Made(lambda value: client.open(later_prompts={9: value}), {}, {"value": TEXT})
    for made in (opening, later):
        for name, label, arguments in wrong(made):
            assert await is_refused_when_awaited(lambda: made.of(**arguments)), f"{name} takes {label}"  # noqa: B023
    for _, label, arguments in wrong(Made(client.stream, {}, {"report_hz": {"float"}})):
        assert is_refused(lambda: client.stream(**arguments)), label  # noqa: B023
    assert (await other.set_prompt("a person runs")).effective_frame is not None


class Clips(FakeServer):
    """A server that offers clips, and fails if one is requested."""

    def GetCatalog(
        self, request: service_pb2.GetCatalogRequest, context: grpc.ServicerContext
    ) -> service_pb2.GetCatalogResponse:
        offered = catalog(self.frame_rate)
        offered.limits.max_clip_frames, offered.limits.max_clip_samples = 100, 4
        return offered


async def test_clip_with_wrong_values_is_refused_before_it_is_requested() -> None:
    takes = {**OPENING, "num_frames": WHOLE, "num_samples": WHOLE, "timeout_s": {*NUMBER, "inf", "None"}}
    with Clips() as server:
        async with MotionClient(server.address) as client:
            made = Made(client.generate_clip, {"num_frames": 8}, takes)
            for name, label, arguments in wrong(made):
                assert await is_refused_when_awaited(lambda: client.generate_clip(**arguments)), (  # noqa: B023
                    f"{name} takes {label}"
                )
            for name, most in (("num_frames", 100), ("num_samples", 4)):
                with pytest.raises(InvalidInput, match=rf"^{name}: .*{most + 1}.* 1 to {most} "):
                    await client.generate_clip(**{"num_frames": 8, name: most + 1})


async def test_admin_calls_with_wrong_values_are_refused() -> None:
    admin = AdminClient("localhost:1")
    asking = [
        Made(admin.load_model, {}, {"source": TEXT}),
        *(
            Made(ask, {"model_id": "a"}, {"model_id": TEXT, "grace_s": {"float", "None"}})
            for ask in (admin.unload_model, admin.reload_model)
        ),
    ]
    for made in asking:
        for name, label, arguments in wrong(made):
            assert await is_refused_when_awaited(lambda: made.of(**arguments)), f"{name} takes {label}"  # noqa: B023
    await admin.close()


async def test_reports_continue_when_underruns_exceed_their_field() -> None:
    """At a great time scale, even a short underrun counts very many frame times."""
    session = await open_with_frames(Line())
    session.playback.advance(0.0)
    session.set_time_scale(1e15)
    session.playback.advance(1.0)
    session.playback.advance(2.0)
    assert session.stats.underruns > 2**32
    assert session.report().playhead.underruns == 2**32 - 1


async def test_client_with_an_infinite_hello_timeout_reconnects(server: FakeServer) -> None:
    async with MotionClient(server.address, policy=LinePolicy(hello_timeout_s=math.inf)) as client:
        session = await client.open("a person walks")
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)
        async with asyncio.timeout(LIMIT_S):
            await until(lambda: session.reopenings)


async def test_callback_that_would_have_to_be_awaited_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    async def keep(is_durable: bool) -> None:
        raise AssertionError("nobody awaits it")

    session = await open_with_frames(Line())
    session.on_durability = keep  # type: ignore[assignment]
    session.hear(session_pb2.SessionUpdate(session=1, durability=session_pb2.SessionDurability(is_kept=True)))
    assert "a callback must be a plain function" in caplog.text
