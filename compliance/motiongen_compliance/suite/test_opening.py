"""The catalogue, hello, and how sessions open."""

from __future__ import annotations

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_compliance.messages import addressed, close, span, waypoint
from motiongen_compliance.talk import LIMIT_S, rig_of
from motiongen_compliance.target import Target

HELLO = service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello())


async def test_catalogue_is_consistent_and_left_out_for_a_known_etag(target: Target) -> None:
    catalog = target.catalog
    rig, model = rig_of(catalog), catalog.models[0]
    assert {each.rig_id for each in catalog.models} <= {each.rig_id for each in catalog.rigs}
    assert len(rig.parents) == len(rig.joints) == len(rig.neutral_offsets_m) // 3
    assert rig.parents[0] == -1
    assert all(parent < joint for joint, parent in enumerate(rig.parents))
    assert all(block.width >= 1 for block in rig.blocks)
    assert model.min_denoise_steps <= model.default_denoise_steps <= model.max_denoise_steps
    assert model.horizon_frames <= catalog.limits.default_lookahead_frames <= catalog.limits.max_lookahead_frames
    assert model.licence
    assert model.default_guidance.HasField("text")
    assert model.default_guidance.HasField("constraint")
    again = await target.stub.GetCatalog(
        service_pb2.GetCatalogRequest(catalog_etag=catalog.catalog_etag), timeout=LIMIT_S
    )
    assert not again.HasField("free_share") or 0 <= again.free_share <= 1
    again.ClearField("free_share")
    assert again == service_pb2.GetCatalogResponse(catalog_etag=catalog.catalog_etag)
    whole = await target.stub.GetCatalog(service_pb2.GetCatalogRequest(catalog_etag="another"), timeout=LIMIT_S)
    assert (whole.catalog_etag, whole.rigs, whole.models) == (catalog.catalog_etag, catalog.rigs, catalog.models)


async def test_hello_comes_first_with_the_limits_of_the_catalogue(target: Target) -> None:
    talk = await target.talk()
    hello = talk.responses[0].hello
    assert hello.limits == target.catalog.limits
    assert hello.replica_id
    assert hello.server_time_ns > 0


async def test_events_may_come_with_hello(target: Target) -> None:
    talk = target.stream()
    opening = session_pb2.SessionEvent(session=5, event_seq=1, open=session_pb2.OpenSession())
    await talk.say(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello(), events=[opening]))
    assert (await talk.hear()).HasField("hello")
    await talk.until(lambda: 5 in talk.sessions and talk.sessions[5].chunks)


@pytest.mark.parametrize(
    ("messages", "reason"),
    [
        ([service_pb2.StreamMotionRequest(events=[session_pb2.SessionEvent(event_seq=1)])], "HELLO_EXPECTED"),
        ([service_pb2.StreamMotionRequest(ping=service_pb2.Ping())], "HELLO_EXPECTED"),
        ([service_pb2.StreamMotionRequest()], "HELLO_EXPECTED"),
        ([HELLO, HELLO], "HELLO_REPEATED"),
    ],
    ids=["event", "ping", "nothing", "twice"],
)
async def test_stream_that_does_not_begin_with_one_hello_ends_with_details(
    target: Target, messages: list[service_pb2.StreamMotionRequest], reason: str
) -> None:
    other = await target.talk()
    await other.open(1)
    talk = target.stream()
    for message in messages:
        await talk.say(message)
    assert await talk.to_the_end() is grpc.StatusCode.INVALID_ARGUMENT
    status = await rpc_status.aio.from_call(talk.call)
    info, request = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest()
    assert status.details[0].Unpack(info)
    assert status.details[1].Unpack(request)
    assert (info.reason, info.domain) == (reason, "motiongen")
    assert [violation.field for violation in request.field_violations] == ["hello"]
    await other.plays_on(1)


async def test_session_opened_states_the_defaults(target: Target) -> None:
    talk, catalog = await target.talk(), target.catalog
    heard = await talk.open(0)
    opened = heard.opened
    assert opened is not None
    assert opened.session_id
    assert (opened.rig_id, opened.model_id) == (rig_of(catalog).rig_id, catalog.models[0].model_id)
    assert opened.frame_rate == rig_of(catalog).frame_rate
    assert opened.lookahead_frames == catalog.limits.default_lookahead_frames
    assert opened.denoise_steps == catalog.models[0].default_denoise_steps
    assert opened.scalar_type == motion_pb2.SCALAR_TYPE_F32_LE
    assert opened.start_frame == 0
    assert heard.applied_seq == 1


async def test_options_of_an_open_are_accepted(target: Target) -> None:
    talk, catalog = await target.talk(), target.catalog
    heard = await talk.open(
        7,
        request_id="x" * 64,
        seed=2**64 - 1,
        rig_id=rig_of(catalog).rig_id,
        model_id=catalog.models[0].model_id,
        priority=session_pb2.PRIORITY_CLASS_HERO,
        lookahead_frames=catalog.limits.max_lookahead_frames,
        denoise_steps=catalog.models[0].max_denoise_steps,
        guidance=session_pb2.Guidance(text=0.0, constraint=catalog.limits.max_guidance),
        prompts=[span(), span("wave", 2, start=60, end=90)],
        constraints=[waypoint(30, x=1.0, z=2.0)],
        start_pose=session_pb2.StartPose(x=1.0, z=-1.0, heading=0.5),
    )
    assert heard.opened is not None
    assert heard.opened.seed == 2**64 - 1
    assert heard.opened.lookahead_frames == catalog.limits.max_lookahead_frames
    assert heard.opened.denoise_steps == catalog.models[0].max_denoise_steps


async def test_session_ids_differ_even_when_a_handle_is_reused(target: Target) -> None:
    talk, other = await target.talk(), await target.talk()
    sessions = [await talk.open(1), await talk.open(2), await other.open(1)]
    await talk.close(1)
    sessions.append(await talk.open(1))
    assert len({heard.opened.session_id for heard in sessions if heard.opened}) == 4


async def test_repeated_open_is_dropped_and_a_different_one_refused(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1, request_id="mine")
    await talk.open(2)
    repetition = session_pb2.OpenSession(request_id="mine")
    other = session_pb2.OpenSession(request_id="other")
    await talk.send(session_pb2.SessionEvent(session=1, event_seq=1, open=repetition))
    await talk.send(session_pb2.SessionEvent(session=1, event_seq=1, open=other))
    outcome = await talk.answer(1, 1)
    assert (outcome.code, outcome.reason) == (grpc.StatusCode.ALREADY_EXISTS.value[0], "HANDLE_IN_USE")
    assert outcome.field == "session"
    assert outcome.allowed
    assert len(heard.outcomes) == 1, "the repetition was dropped"
    await talk.plays_on(1)
    await talk.plays_on(2)


async def test_handle_may_be_reused_after_its_session_closed(target: Target) -> None:
    talk = await target.talk()
    await talk.open(1)
    await talk.plays_on(1)
    await talk.close(1)
    again = await talk.open(1)
    assert again.chunks[0].first_frame == 0
    assert again.applied_seq == 1
    await talk.plays_on(1)


async def test_one_message_carries_many_sessions_in_both_directions(target: Target) -> None:
    talk = await target.talk()
    handles = range(10, 22)
    await talk.send(
        *(
            session_pb2.SessionEvent(session=handle, event_seq=1, open=session_pb2.OpenSession(seed=handle))
            for handle in handles
        )
    )
    await talk.until(lambda: all(handle in talk.sessions and talk.sessions[handle].chunks for handle in handles))
    assert max(len({update.session for update in response.updates}) for response in talk.responses) > 1
    assert {talk.sessions[handle].opened.seed for handle in handles} == set(handles)  # type: ignore[union-attr]


async def test_close_may_follow_an_open_at_once(target: Target) -> None:
    talk = await target.talk()
    opening = session_pb2.OpenSession(prompts=[span("a text nobody has sent before")])
    await talk.send(session_pb2.SessionEvent(session=3, event_seq=1, open=opening), addressed(close(), 3, 2))
    await talk.until(lambda: 3 in talk.sessions and talk.sessions[3].closed is not None)
    assert talk.sessions[3].opened is not None
