"""The rules for clients (`docs/protocol.md`, "Writing a client"), checked on everything that a client sends."""

from __future__ import annotations

from dataclasses import dataclass, field

from motiongen.v1 import service_pb2, session_pb2
from motiongen_compliance.heard import Heard, require

MOST_AGENT_CHARACTERS = 128
RESUMING = frozenset({"request_id", "resume_token", "resume_point"})


@dataclass
class Cut:
    """Frames up to `end` had been sent when a plan replaced some of them. A report may cross that plan on its way.

    answered_seq: of the first answer after the plan: a client that has received it has received the plan. 0: none yet.
    """

    end: int
    answered_seq: int = 0


@dataclass
class Told:
    """One session: what its client has sent and received. It outlives a stream by its token."""

    heard: Heard | None = None  # checks the server, too; None for a session that was resumed
    sent_seq: int = 0  # on the current stream, or answered before it
    most_sent: int = 0  # on any stream
    is_closing: bool = False
    is_over: bool = False
    token: str = ""
    attempt: int = 0
    end: int = 0  # of the frames sent to the client
    cuts: list[Cut] = field(default_factory=list)  # plans that the client may not have received
    playhead: int = 0
    answered: set[int] = field(default_factory=set)
    kinds: list[str] = field(default_factory=list)

    def say(self, event: session_pb2.SessionEvent) -> None:
        """Check an event that is not an OpenSession."""
        kind = event.WhichOneof("event")
        require(kind is not None, "an event says something")
        self.kinds.append(str(kind))
        if kind == "playhead":
            require(event.event_seq == 0, "a Playhead has the number 0")
            self._report(event.playhead)
            return
        require(not self.is_closing, "nothing is said of a session after CloseSession")
        # events that were answered when the session was resumed need not be sent again
        left_out = [number for number in range(self.sent_seq + 1, event.event_seq) if number not in self.answered]
        rises = event.event_seq > self.sent_seq and not left_out
        require(rises, f"numbers rise by one: {event.event_seq} after {self.sent_seq}")
        self.sent_seq = event.event_seq
        self.most_sent = max(self.most_sent, event.event_seq)
        if self.heard is not None:
            self.heard.sent_seq = event.event_seq
        self.is_closing = kind == "close"

    def held(self, answered_seq: int) -> int:
        """The most frames that a client can hold if it has received the answers up to that one."""
        self.cuts = [cut for cut in self.cuts if not 0 < cut.answered_seq <= answered_seq]
        return max(self.end, *(cut.end for cut in self.cuts), 0)

    def _report(self, report: session_pb2.Playhead) -> None:
        end = self.held(report.answered_seq)
        require(report.frame >= self.playhead, f"a playhead never falls: {report.frame} after {self.playhead}")
        require(report.frame <= max(end - 1, 0), f"frame {report.frame} is shown, but {end} were sent")
        require(report.buffered_to <= end, f"{report.buffered_to} frames are held, but {end} were sent")
        require(report.answered_seq <= self.most_sent, "no event is answered that was not sent")
        missing = [number for number in range(2, report.answered_seq + 1) if number not in self.answered]
        require(not missing, f"{missing} are said to be answered, and were not")
        self.playhead = report.frame
        if self.heard is not None:
            self.heard.playhead = report.frame

    def hear(self, update: session_pb2.SessionUpdate) -> None:
        """Record an update sent to the client."""
        if self.heard is not None:
            self.heard.take(update)
        match update.WhichOneof("update"):
            case "opened":
                self.token = update.opened.session_token
            case "plan":
                if update.plan.valid_from < self.end:
                    self.cuts.append(Cut(self.end))
                self.end = min(self.end, update.plan.valid_from)
            case "chunk":
                self.end = update.chunk.first_frame + update.chunk.frame_count
            case "outcome":
                self.answered.add(update.outcome.event_seq)
                for cut in self.cuts:
                    cut.answered_seq = cut.answered_seq or update.outcome.event_seq
                self.is_over = self.is_over or (update.outcome.event_seq == 1 and update.outcome.code != 0)
            case "closed":
                self.is_over = True


class StreamRules:
    """One stream of a client. kept: sessions of earlier streams, by token; shared by the streams of a test."""

    def __init__(self, catalog: service_pb2.GetCatalogResponse, kept: dict[str, Told]) -> None:
        self._most_bytes = catalog.limits.max_request_bytes
        self._row_bytes = 4 * sum(block.width for block in catalog.rigs[0].blocks)
        self._kept = kept
        self._is_greeted = False
        self.sessions: dict[int, Told] = {}

    def say(self, request: service_pb2.StreamMotionRequest) -> None:
        """Check a message of the client."""
        require(request.ByteSize() <= self._most_bytes, f"a request has at most {self._most_bytes} bytes")
        require(request.HasField("hello") != self._is_greeted, "hello is in the first message, and only there")
        if not self._is_greeted:
            agent = request.hello.client_agent
            require(0 < len(agent) <= MOST_AGENT_CHARACTERS, f"a client gives its client_agent: {agent!r}")
            self._is_greeted = True
        for event in request.events:
            if event.HasField("open"):
                self._open(event)
            else:
                require(event.session in self.sessions, "a session is opened before anything else is said of it")
                self.sessions[event.session].say(event)

    def _open(self, event: session_pb2.SessionEvent) -> None:
        before = self.sessions.get(event.session)
        require(before is None or before.is_over, "a handle is used again when its session is over")
        require(event.event_seq == 1, "an OpenSession has the number 1")
        if not event.open.resume_token:
            self.sessions[event.session] = Told(Heard(self._row_bytes), sent_seq=1, most_sent=1, kinds=["open"])
            return
        given = {field.name for field, _ in event.open.ListFields()}
        require(given <= RESUMING, f"an open that resumes has nothing else: {given - RESUMING}")
        told = self._kept.get(event.open.resume_token)
        require(told is not None, "a token is one that the server gave")
        assert told is not None
        self.sessions[event.session] = told
        point = event.open.resume_point
        require(point.attempt > told.attempt, "each attempt to resume has a higher number")
        end = told.held(point.answered_seq)
        require(point.next_frame <= end, f"{point.next_frame} frames are held, but {end} were sent")
        require(point.answered_seq <= told.most_sent, "no event is answered that was not sent")
        told.attempt, told.heard, told.end = point.attempt, None, point.next_frame
        told.cuts = []
        told.sent_seq = point.answered_seq  # unanswered events are sent again, with their numbers

    def hear(self, response: service_pb2.StreamMotionResponse) -> None:
        """Record a message of the server before the client gets it."""
        for update in response.updates:
            told = self.sessions.get(update.session)
            require(told is not None, "nothing is said of a session that was never opened")
            assert told is not None
            told.hear(update)
            if told.token:
                self._kept[told.token] = told
