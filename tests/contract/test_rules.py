"""The compliance suite's bare client: which breaches of the protocol it finds, and what it accepts."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from contextlib import asynccontextmanager
from types import SimpleNamespace

import grpc.aio
import pytest
from google.protobuf.duration_pb2 import Duration

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.heard import RuleBroken
from motiongen_compliance.messages import PAUSE, addressed
from motiongen_compliance.plugin import MOST_UNANSWERED, pytest_runtest_makereport
from motiongen_compliance.talk import Talk
from motiongen_compliance.target import connect

Update, Response = session_pb2.SessionUpdate, service_pb2.StreamMotionResponse
WIDTH = 7
RIG = motion_pb2.Rig(
    rig_id="r",
    joints=["root"],
    parents=[-1],
    frame_rate=20,
    blocks=[
        motion_pb2.ChannelBlock(name="root_translation_m", width=3),
        motion_pb2.ChannelBlock(name="joint_rotation_quat_wxyz", width=4),
    ],
)
OTHER_RIG = motion_pb2.Rig(rig_id="other", joints=["a", "b"], parents=[-1, 0])
CATALOG = service_pb2.GetCatalogResponse(
    rigs=[OTHER_RIG, RIG], models=[service_pb2.Model(model_id="m", rig_id="r", horizon_frames=40)]
)


class Scripted(service_pb2_grpc.MotionServiceServicer):
    """Sends hello, and then the responses of the script whenever a request has events."""

    def __init__(self, script: Sequence[Response]) -> None:
        self._script = script

    async def GetCatalog(self, request: object, context: object) -> service_pb2.GetCatalogResponse:
        return CATALOG

    async def StreamMotion(
        self, requests: AsyncIterator[service_pb2.StreamMotionRequest], context: object
    ) -> AsyncIterator[Response]:
        yield Response(hello=service_pb2.ServerHello(replica_id="one"))
        async for request in requests:
            for response in self._script if request.events else ():
                yield response


@asynccontextmanager
async def hearing(script: Sequence[Response]) -> AsyncIterator[Talk]:
    """A stream on which session 1 was opened and event 2 was sent for it."""
    server = grpc.aio.server()
    service_pb2_grpc.add_MotionServiceServicer_to_server(Scripted(script), server)
    address = f"127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    await server.start()
    try:
        async for target in connect(address):
            talk = await target.talk()
            opening = session_pb2.SessionEvent(session=1, event_seq=1, open=session_pb2.OpenSession())
            await talk.send(opening, addressed(PAUSE, 1, 2))
            await talk.call.done_writing()
            yield talk
    finally:
        await server.stop(None)


def of(update: Update, applied_seq: int = 1) -> Response:
    update.session, update.applied_seq = 1, applied_seq
    return Response(updates=[update])


def opened(scalar_type: int = motion_pb2.SCALAR_TYPE_F32_LE, start_frame: int = 0) -> Response:
    return of(
        Update(
            opened=session_pb2.SessionOpened(
                session_id="s", lookahead_frames=40, scalar_type=scalar_type, start_frame=start_frame
            )
        )
    )


def plan(number: int, cause: int, valid_from: int = 0, event_seqs: Iterable[int] = ()) -> Response:
    notice = session_pb2.PlanNotice(plan=number, cause=cause, valid_from=valid_from, event_seqs=event_seqs)  # type: ignore[arg-type]
    return of(Update(plan=notice))


def chunk(number: int, num_bytes: int = 4 * WIDTH, **fields: object) -> Response:
    fields = {"scalar_type": motion_pb2.SCALAR_TYPE_F32_LE, "frame_count": 1} | fields
    return of(Update(chunk=motion_pb2.FrameChunk(plan=number, data=bytes(num_bytes), **fields)))  # type: ignore[arg-type]


def level(tier: int, steps: int) -> Response:
    return of(Update(service_level=session_pb2.ServiceLevel(tier=tier, denoise_steps=steps)))  # type: ignore[arg-type]


def durable(event_seq: int) -> Response:
    return of(Update(durable_seq=event_seq, durability=session_pb2.SessionDurability(is_kept=True)), 2)


def reached(frame: int) -> Response:
    return of(Update(constraint_reached=session_pb2.ConstraintReached(constraint_id=1, frame=frame)))


def refusal(**fields: object) -> Response:
    said = {"event_seq": 2, "code": 3, "reason": "NOT_FINITE", "message": "NaN"} | fields
    return of(Update(outcome=session_pb2.EditOutcome(**said)), 2)  # type: ignore[arg-type]


def edited(effective_frame: int) -> Response:
    return of(Update(outcome=session_pb2.EditOutcome(event_seq=2, effective_frame=effective_frame)), 2)


def answer(event_seq: int) -> Response:
    return of(Update(outcome=session_pb2.EditOutcome(event_seq=event_seq)), event_seq)


F16, QUANTISED = motion_pb2.SCALAR_TYPE_F16_LE, motion_pb2.SCALAR_TYPE_QUANTISED
CONTINUE, EDIT, FALLBACK, RESUME = (
    session_pb2.PLAN_CAUSE_CONTINUE,
    session_pb2.PLAN_CAUSE_EDIT,
    session_pb2.PLAN_CAUSE_FALLBACK,
    session_pb2.PLAN_CAUSE_RESUME,
)
FIRST = plan(1, CONTINUE)
GOODBYE = Response(goodbye=service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING))
EXPIRING = Response(goodbye=service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_CREDENTIALS_EXPIRING))


@pytest.mark.parametrize(
    ("script", "rule"),
    [
        ([Response(hello=service_pb2.ServerHello())], "hello is in the first message, and only there"),
        ([GOODBYE, GOODBYE], "a Goodbye comes once for each reason"),
        ([Response(updates=[Update(session=7, opened=session_pb2.SessionOpened())])], "never used"),
        ([opened(start_frame=3)], "a new session begins with frame 0"),
        ([opened(), of(Update(chunk=motion_pb2.FrameChunk()), 3)], "applied_seq is not above what was sent"),
        ([opened(), answer(3)], "applied_seq is not above what was sent"),
        ([opened(), durable(1)], "every event up to applied_seq has been answered"),
        ([opened(), FIRST, chunk(1), edited(0), plan(2, EDIT, event_seqs=[2])], "after the notice of its plan"),
        ([opened(), answer(2), durable(3)], "durable_seq never falls"),
        ([opened(), of(Update(durable_seq=1, plan=session_pb2.PlanNotice()))], "beside durability only"),
        ([opened(), FIRST, plan(2, EDIT)], "an edit's plan names its events"),
        ([opened(), FIRST, plan(2, EDIT, event_seqs=[9])], "a plan names events that were sent"),
        ([opened(), FIRST, plan(2, RESUME)], "right after the SessionOpened of a resume"),
        ([opened(), level(session_pb2.SERVICE_TIER_HOLD, 4)], "HOLD has none"),
        ([opened(), level(session_pb2.SERVICE_TIER_FEWER_STEPS, 0)], "a tier has denoising steps"),
        ([opened(), FIRST, chunk(1, committed_to=1), reached(0), reached(0)], "comes once for a constraint"),
        ([opened(), refusal(code=0)], "an accepted event has no reason"),
        ([opened(), refusal(code=17)], "a google.rpc.Code"),
        ([opened(), refusal(reason="too bad")], "UPPER_SNAKE_CASE"),
        ([opened(), refusal(code=9, retry_after=Duration(seconds=1))], "retry_after is for"),
        ([opened(), refusal(placements=[motion_pb2.ConstraintPlacement(constraint_id=1)])], "has no placements"),
        ([opened(), of(Update(closed=session_pb2.SessionClosed()))], "closed for a reason"),
        ([opened(), FIRST, chunk(1, root_origin_m=[0.0] * 3)], "F16_LE has a root_origin_m"),
        ([opened(F16), FIRST, chunk(1, 2 * WIDTH, scalar_type=F16)], "F16_LE has a root_origin_m"),
        ([opened(F16), FIRST, chunk(1, 4 * WIDTH, scalar_type=F16, root_origin_m=[0.0] * 3)], "as long as its rows"),
        ([opened(QUANTISED), FIRST, chunk(1, 16, scalar_type=QUANTISED)], "as long as its rows"),
    ],
)
async def test_breach_of_the_protocol_is_found(script: list[Response], rule: str) -> None:
    async with hearing(script) as talk:
        with pytest.raises(RuleBroken, match=rule):
            await talk.to_the_end()


@pytest.mark.parametrize(
    "script",
    [
        [opened(), FIRST, chunk(1), plan(2, FALLBACK, 1), chunk(2, first_frame=1)],
        [opened(), answer(2), durable(2)],
        [opened(), FIRST, chunk(1), plan(2, EDIT, event_seqs=[2]), chunk(2), edited(0)],
        [opened(), FIRST, chunk(1), edited(1)],
        [opened(), refusal(code=8, retry_after=Duration(seconds=1), reason="OVERLOADED")],
        [opened(), level(session_pb2.SERVICE_TIER_HOLD, 0), plan(1, FALLBACK)],
        [opened(F16), FIRST, chunk(1, 2 * WIDTH, scalar_type=F16, root_origin_m=[0.0] * 3)],
        [opened(QUANTISED), FIRST, chunk(1, 17, scalar_type=QUANTISED)],
        [EXPIRING, GOODBYE],
    ],
    ids=["helps itself", "saved", "edited", "edited ahead", "refused", "holds", "halves", "quantised", "two reasons"],
)
async def test_allowed_messages_are_accepted(script: list[Response]) -> None:
    async with hearing(script) as talk:
        assert await talk.to_the_end() is grpc.StatusCode.OK


async def test_does_not_wait_for_ever_while_other_messages_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with hearing([opened(), *(plan(number, CONTINUE) for number in range(1, 50))]) as talk:
        await talk.until(lambda: 1 in talk.sessions)
        talk.ends_at = 0.0  # as if the stream had lasted for minutes
        with pytest.raises(TimeoutError, match="what the test waits for"):
            await talk.until(lambda: False)


class Closing(Scripted):
    """Refuses the first OpenSession with a time to retry."""

    async def StreamMotion(
        self, requests: AsyncIterator[service_pb2.StreamMotionRequest], context: object
    ) -> AsyncIterator[Response]:
        yield Response(hello=service_pb2.ServerHello())
        refusal = session_pb2.EditOutcome(event_seq=1, code=8, reason="OVERLOADED", message="full", allowed="later")
        refusal.retry_after.FromMilliseconds(1)
        said: Iterator[list[Response]] = iter([[of(Update(outcome=refusal), 0)], [opened(), FIRST, chunk(1)]])
        async for request in requests:
            for response in next(said) if request.events else ():
                yield response


async def test_refused_open_is_retried() -> None:
    server = grpc.aio.server()
    service_pb2_grpc.add_MotionServiceServicer_to_server(Closing([]), server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    try:
        async for target in connect(f"127.0.0.1:{port}"):
            talk = await target.talk()
            assert (await talk.open(1)).opened is not None
    finally:
        await server.stop(None)


def test_run_is_stopped_when_the_server_does_not_answer() -> None:
    session = SimpleNamespace(stash=pytest.Stash(), shouldfail=False)
    item = SimpleNamespace(session=session)

    def report(failure: Exception | None) -> None:
        excinfo = None if failure is None else SimpleNamespace(value=failure)
        hook = pytest_runtest_makereport(item, SimpleNamespace(excinfo=excinfo, when="call"))  # type: ignore[arg-type]
        next(hook)
        with pytest.raises(StopIteration):
            hook.send(None)  # type: ignore[arg-type]

    for failure in (TimeoutError(), TimeoutError(), RuleBroken("a rule"), TimeoutError(), TimeoutError(), None):
        report(failure)
        assert not session.shouldfail
    for _ in range(MOST_UNANSWERED):
        report(TimeoutError())
    assert "did not answer" in str(session.shouldfail)
