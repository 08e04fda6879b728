"""A small server that follows the protocol with synthetic frames: no model, no engine, and mistakes on demand.

It runs in threads, so that clients with and without asyncio can be tested in one process.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeAlias

import grpc

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.client.synthetic import HORIZON, LOOKAHEAD, catalog, synthetic_rows

LEAD = 50

Refuse: TypeAlias = Callable[[session_pb2.SessionEvent], str | session_pb2.EditOutcome]


@dataclass
class Character:
    """A session as the server sees it."""

    seed: int
    lookahead: int
    plan: int = 0
    playhead: int = 0
    sent_to: int = 0
    planned_to: int = 0
    prompts: dict[int, str] = field(default_factory=dict)
    constraint_ids: set[int] = field(default_factory=set)


class FakeStream:
    """One call. Tests may send anything on it with `push`, or end it with `end` or `fail`."""

    def __init__(self, replica_id: str = "fake") -> None:
        self.replica_id = replica_id
        self.outgoing: queue.Queue[service_pb2.StreamMotionResponse | grpc.StatusCode | None] = queue.Queue()
        self.characters: dict[int, Character] = {}
        self.received: list[session_pb2.SessionEvent] = []
        self.warnings: list[session_pb2.EventWarning] = []  # for every edit that is accepted
        self.pings: list[service_pb2.Ping] = []
        self.answers_pings = True
        self.agent = ""

    def push(self, handle: int, **update: object) -> None:
        message = session_pb2.SessionUpdate(session=handle, **update)  # type: ignore[arg-type]
        self.outgoing.put(service_pb2.StreamMotionResponse(updates=[message]))

    def end(self) -> None:
        self.outgoing.put(None)

    def fail(self, code: grpc.StatusCode) -> None:
        self.outgoing.put(code)

    def read(self, requests: Iterator[service_pb2.StreamMotionRequest], refuse: Callable[..., str]) -> None:
        """Handle the client's messages until it ends or cancels the call."""
        try:
            for request in requests:
                match request.WhichOneof("stream_event"):
                    case "hello":
                        self.agent = request.hello.client_agent
                        self.outgoing.put(
                            service_pb2.StreamMotionResponse(hello=service_pb2.ServerHello(replica_id=self.replica_id))
                        )
                    case "ping":
                        self.pings.append(request.ping)
                        pong = service_pb2.Pong(client_time_ns=request.ping.client_time_ns)
                        if self.answers_pings:
                            self.outgoing.put(service_pb2.StreamMotionResponse(pong=pong))
                for event in request.events:
                    self.received.append(event)
                    self.take(event, refuse)
            for handle in list(self.characters):
                self.close(handle)
        except grpc.RpcError:
            pass
        self.outgoing.put(None)

    def take(self, event: session_pb2.SessionEvent, refuse: Callable[..., str]) -> None:
        kind = event.WhichOneof("event")
        reason = refuse(event)
        if isinstance(reason, session_pb2.EditOutcome):
            reason.event_seq = event.event_seq
            self.push(event.session, outcome=reason)
            return
        if reason:
            outcome = session_pb2.EditOutcome(
                event_seq=event.event_seq,
                code=3,
                reason=reason,
                message="no",
                field=f"{kind}.x",
                allowed="other things",
            )
            self.push(event.session, outcome=outcome)
            return
        match kind:
            case "open":
                self.open(event)
            case "edit_prompts":
                character = self.characters[event.session]
                for key in event.edit_prompts.remove:
                    del character.prompts[key]
                character.prompts |= {span.prompt_id: span.text for span in event.edit_prompts.upsert}
                self.replan(event)
            case "edit_constraints":
                ids = self.characters[event.session].constraint_ids
                if event.edit_constraints.clear:
                    ids.clear()
                ids -= set(event.edit_constraints.remove)
                ids |= {constraint.constraint_id for constraint in event.edit_constraints.upsert}
                self.replan(event)
            case "set_velocity" | "seek" | "set_options":
                self.replan(event)
            case "set_play_state":
                self.push(event.session, outcome=session_pb2.EditOutcome(event_seq=event.event_seq))
            case "playhead":
                if event.session in self.characters:
                    self.characters[event.session].playhead = event.playhead.frame
                    self.send_frames(event.session)
            case "close":
                self.close(event.session)

    def open(self, event: session_pb2.SessionEvent) -> None:
        message = event.open
        character = Character(message.seed or 7, message.lookahead_frames or LOOKAHEAD)
        character.prompts = {span.prompt_id: span.text for span in message.prompts}
        character.constraint_ids = {constraint.constraint_id for constraint in message.constraints}
        self.characters[event.session] = character
        opened = session_pb2.SessionOpened(
            session_id=f"s{event.session}",
            seed=character.seed,
            rig_id="stick9",
            model_id=message.model_id or "synthetic",
            lookahead_frames=character.lookahead,
            denoise_steps=4,
        )
        self.push(event.session, opened=opened)
        self.send_frames(event.session)

    def send_frames(self, handle: int) -> None:
        """Send plans and chunks as far as the credit reaches."""
        character = self.characters[handle]
        while (end := min(character.playhead + character.lookahead, character.sent_to + 8)) > character.sent_to:
            if character.sent_to == character.planned_to:
                self.announce(handle, character.planned_to, session_pb2.PLAN_CAUSE_CONTINUE)
            self.send_chunk(handle, min(end, character.planned_to))

    def announce(
        self, handle: int, valid_from: int, cause: session_pb2.PlanCause, event_seqs: tuple[int, ...] = ()
    ) -> None:
        character = self.characters[handle]
        character.plan += 1
        character.planned_to = valid_from + HORIZON
        notice = session_pb2.PlanNotice(plan=character.plan, valid_from=valid_from, cause=cause, event_seqs=event_seqs)
        self.push(handle, plan=notice)

    def send_chunk(self, handle: int, end: int) -> None:
        character = self.characters[handle]
        rows = synthetic_rows(character.plan, character.sent_to, end - character.sent_to)
        chunk = motion_pb2.FrameChunk(
            plan=character.plan,
            first_frame=character.sent_to,
            frame_count=len(rows),
            committed_to=min(character.playhead + 4, end),
            data=rows.astype("<f4").tobytes(),
            scalar_type=motion_pb2.SCALAR_TYPE_F32_LE,
        )
        character.sent_to = end
        self.push(handle, chunk=chunk)

    def replan(self, event: session_pb2.SessionEvent) -> None:
        character = self.characters[event.session]
        valid_from = min(character.playhead + LEAD, character.sent_to)
        character.sent_to = valid_from
        self.announce(event.session, valid_from, session_pb2.PLAN_CAUSE_EDIT, (event.event_seq,))
        self.send_chunk(event.session, valid_from + 8)
        outcome = session_pb2.EditOutcome(event_seq=event.event_seq, effective_frame=valid_from, warnings=self.warnings)
        self.push(event.session, outcome=outcome)
        self.send_frames(event.session)

    def close(self, handle: int) -> None:
        character = self.characters.pop(handle)
        closed = session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_CLIENT, frames=character.sent_to)
        self.push(handle, closed=closed)


class FakeServer(service_pb2_grpc.MotionServiceServicer):
    """Use it as `with FakeServer() as server`. frame_rate: high, so that tests in real time are short.

    refuse: returns the reason to refuse an event, or "", or the outcome to refuse it with. replica_id: its name.
    """

    def __init__(self, frame_rate: int = 100, replica_id: str = "fake", listen: str = "127.0.0.1:0") -> None:
        self.replica_id = replica_id
        self.frame_rate = frame_rate
        self.streams: list[FakeStream] = []
        self.metadata: list[dict[str, str | bytes]] = []  # of every call
        self.refuse: Refuse = lambda event: ""
        self.turned_away: list[grpc.Status] = []  # how the next streams are refused
        self._threads = ThreadPoolExecutor(16)
        self._server = grpc.server(self._threads)
        service_pb2_grpc.add_MotionServiceServicer_to_server(self, self._server)
        port = self._server.add_insecure_port(listen)
        self.address = listen if listen.startswith("unix:") else f"127.0.0.1:{port}"

    def GetCatalog(
        self, request: service_pb2.GetCatalogRequest, context: grpc.ServicerContext
    ) -> service_pb2.GetCatalogResponse:
        self.metadata.append(dict(context.invocation_metadata()))
        return catalog(self.frame_rate)

    def StreamMotion(
        self, request_iterator: Iterator[service_pb2.StreamMotionRequest], context: grpc.ServicerContext
    ) -> Iterator[service_pb2.StreamMotionResponse]:
        self.metadata.append(dict(context.invocation_metadata()))
        if self.turned_away:
            context.abort_with_status(self.turned_away.pop(0))
        stream = FakeStream(self.replica_id)
        self.streams.append(stream)
        reader = threading.Thread(target=stream.read, args=(request_iterator, lambda event: self.refuse(event)))
        reader.start()
        while (response := stream.outgoing.get()) is not None:
            if isinstance(response, grpc.StatusCode):
                context.abort(response, "as the test wished")
            yield response

    @property
    def stream(self) -> FakeStream:
        """The latest call."""
        return self.streams[-1]

    def __enter__(self) -> FakeServer:
        self._server.start()
        return self

    def __exit__(self, *_: object) -> None:
        for stream in self.streams:
            stream.end()
        self._server.stop(None).wait()
        self._threads.shutdown()


def full(*others: tuple[str, str]) -> Refuse:
    """The refusals of a full server that names others, by address and key."""

    def refuse(event: session_pb2.SessionEvent) -> str | session_pb2.EditOutcome:
        if not event.HasField("open"):
            return ""
        outcome = session_pb2.EditOutcome(code=8, reason="OVERLOADED", message="full")
        outcome.retry_after.FromSeconds(3600)
        for address, key in others:
            outcome.other_servers.add(address=address, routing_key=key)
        return outcome

    return refuse
