"""EngineHost: all models of an engine process. Reads the gateway's messages, and loads models on the main thread."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
import zmq

from motiongen_server.engine.engine import Engine
from motiongen_server.engine.types import Float32Array
from motiongen_server.engine_process.bell import Bell
from motiongen_server.engine_process.codec import CodecError, sendable
from motiongen_server.engine_process.messages import (
    TO_ENGINE,
    TO_GATEWAY,
    CloseAhead,
    Encoded,
    EncoderReady,
    EncodeTexts,
    Ended,
    Events,
    Load,
    LoadEncoder,
    OwnerChanged,
    Ready,
    StepsElsewhere,
    Stop,
    ToEngine,
    Unload,
    Unloaded,
)
from motiongen_server.engine_process.outlet import Outlet, Wire
from motiongen_server.engine_process.slot import BuildEngine, Built, Slot
from motiongen_server.engine_process.sockets import EngineEnd, poller_of
from motiongen_server.ops.memory import FreedMemory, free_garbage, give_back_freed_memory, settle_again
from motiongen_server.settings import SettingError

_log = logging.getLogger(__name__)

FREED_EVERY_S = 2.0
"""How often to check whether memory should be given back."""
BLOCKED_MS = 10
"""How often to check whether the gateway, or an engine, takes messages again."""


class TextEncoder(Protocol):
    """Encodes prompts in this process, on a thread of its own."""

    @property
    def identity(self) -> str: ...

    def encode(self, texts: Sequence[str]) -> Float32Array: ...


FreeUnused = Callable[[], None]
"""Frees what is only kept for later windows, when no session is open. On the main thread; takes milliseconds."""
LoadText = Callable[[int], TextEncoder]
"""Loads the configured text encoder for a width. Raises SettingError."""


class EngineHost:
    """Has three kinds of threads: the main thread loads (libraries that crash elsewhere crash there too, and never
    while the process is ending), one thread reads the sockets, and each model's engine has a thread.
    """

    def __init__(
        self, end: EngineEnd, wire: Wire, build: BuildEngine, load_text: LoadText, free_unused: FreeUnused
    ) -> None:
        self._end = end
        self._wire = wire
        self._free_unused = free_unused
        self._build = build
        self._load_text = load_text
        self._slots: dict[int, Slot] = {}
        self._leaving: dict[int, Slot] = {}  # those that are sending their last message
        self._jobs: queue.SimpleQueue[Load | LoadEncoder | Slot | Stop | BaseException] = queue.SimpleQueue()
        self._texts: queue.SimpleQueue[EncodeTexts] = queue.SimpleQueue()
        self._bell = Bell()
        self._freed = FreedMemory()
        wire.on_blocked = self._bell.ring  # the reader must flush, and may be waiting for messages that do not come
        self._is_over = False
        self._is_stopping = False
        self._news = poller_of([end.ahead, self._bell.fileno(), end.events])
        self._ahead = poller_of([end.ahead, self._bell.fileno()])

    # ---- the main thread --------------------------------------------------------------------------------------------

    def run(self) -> BaseException | None:
        """Serve until the gateway sends Stop. Returns what failed, if anything did."""
        reader = threading.Thread(target=self._read, name="reader", daemon=True)
        reader.start()
        failure = self._work()
        for slot in tuple(self._slots.values()):
            slot.stop()
        if failure is None:
            for slot in (*tuple(self._slots.values()), *tuple(self._leaving.values())):
                slot.join()
        self._is_over = True
        self._bell.ring()
        reader.join()
        return failure

    def _work(self) -> BaseException | None:
        while True:
            try:
                job = self._jobs.get(timeout=FREED_EVERY_S)
            except queue.Empty:
                is_busy = any(slot.is_busy for slot in tuple(self._slots.values()))
                if self._freed.is_due(is_busy=is_busy):
                    if not is_busy:
                        self._free_unused()
                        free_garbage()
                    give_back_freed_memory()
                continue
            if isinstance(job, Load):
                self._load(job)
            elif isinstance(job, LoadEncoder):
                self._load_encoder(job)
            elif isinstance(job, Slot):
                job.join()
                del job  # the last reference to its engine
                settle_again()
            else:
                return None if isinstance(job, Stop) else job

    def _load(self, job: Load) -> None:
        outlet = Outlet(self._wire, job.slot)
        slot = Slot(job.slot, outlet.deliver)
        built = self._built(job, slot, outlet)
        if isinstance(built, Unloaded):
            self._free_remains()
            self._wire.say(built)
            return
        engine, ready = built
        settle_again()  # before the engine has work
        self._slots[job.slot] = slot
        slot.start(engine, self._ended)
        self._wire.send(ready)

    def _built(self, job: Load, slot: Slot, outlet: Outlet) -> tuple[Engine, bytes] | Unloaded:
        """An engine and its encoded Ready message, or why there is none."""
        try:
            built = self._build(job.source, outlet.deliver, outlet.observe, slot.inbox)
            ready = _encoded(Ready(job.slot, built.facts, built.licence, built.abilities, built.weights), built)
        except SettingError as error:
            return Unloaded(job.slot, sendable(str(error)), is_setting=True)
        except Exception as error:
            _log.exception("loading %r failed", job.source)
            return Unloaded(job.slot, sendable(f"{type(error).__name__}: {error}"))
        return built.engine, ready

    def _load_encoder(self, job: LoadEncoder) -> None:
        encoder = self._loaded_encoder(job)
        if isinstance(encoder, EncoderReady):
            self._free_remains()
            self._wire.say(encoder)
            return
        self._wire.say(EncoderReady(encoder.identity, job.width, ""))  # before any vectors: their encoder
        threading.Thread(target=self._encode, args=(encoder,), name="text", daemon=True).start()

    def _loaded_encoder(self, job: LoadEncoder) -> TextEncoder | EncoderReady:
        """The encoder, or why there is none."""
        try:
            return self._load_text(job.width)
        except SettingError as error:
            return EncoderReady("", 0, sendable(str(error)))
        except Exception as error:  # such as no memory: models, and prompts that are known, are still served
            _log.exception("loading the text encoder failed")
            return EncoderReady("", 0, sendable(f"{type(error).__name__}: {error}"))

    @staticmethod
    def _free_remains() -> None:
        """Free what could not be loaded: a whole model, in cycles. The next may be loaded before an idle moment."""
        free_garbage()
        give_back_freed_memory()

    # ---- the encoder's thread ---------------------------------------------------------------------------------------

    def _encode(self, encoder: TextEncoder) -> None:
        while True:
            job = self._texts.get()
            try:
                self._wire.say(Encoded(job.number, encoder.encode(job.texts), ""))
            except Exception as error:
                _log.exception("encoding a prompt failed")
                why = sendable(f"{type(error).__name__}: {error}")
                self._wire.say(Encoded(job.number, np.zeros((0, 0), np.float32), why))

    # ---- an engine's thread -----------------------------------------------------------------------------------------

    def _ended(self, slot: Slot, failure: BaseException | None) -> None:
        self._leaving[slot.number] = slot  # until its last message is sent: the sockets are closed only after that
        del self._slots[slot.number]
        if failure is not None:
            self._fail(failure)
        else:
            if not self._is_stopping:
                # Settled later, since this thread still holds the engine; queued before the gateway can ask for a load.
                self._jobs.put(slot)
            self._wire.say(Unloaded(slot.number))
        del self._leaving[slot.number]

    def _fail(self, error: BaseException) -> None:
        """End the process. The gateway is told at once: the main thread may be loading a model for minutes, and no
        client would be answered until then.
        """
        self._jobs.put(error)
        if not self._is_stopping:
            self._wire.say(ended_by(error))

    # ---- the reader's thread ----------------------------------------------------------------------------------------

    def _read(self) -> None:
        try:
            while not self._is_over:
                self._wire.flush()
                # While the gateway does not read, only urgent messages are taken, so that all queues stay bounded.
                is_blocked = self._is_blocked
                (self._ahead if is_blocked else self._news).poll(BLOCKED_MS if is_blocked else None)
                self._bell.quiet()
                while (message := self._receive(self._end.ahead)) is not None:
                    self._obey(message)
                if not self._is_blocked and (message := self._receive(self._end.events)) is not None:
                    if not isinstance(message, Events):
                        raise CodecError(f"{type(message).__name__} came on the way for events")
                    self._pass_on(message)
        except Exception as error:
            _log.exception("what the gateway says cannot be read")
            self._fail(error)

    @property
    def _is_blocked(self) -> bool:
        return self._wire.is_blocked or any(slot.is_full for slot in tuple(self._slots.values()))

    def _obey(self, message: ToEngine) -> None:
        if isinstance(message, CloseAhead):
            self._pass_on(message)
        elif isinstance(message, Unload):
            slot = self._slots.get(message.slot)
            if slot is not None:
                slot.stop()
        elif isinstance(message, StepsElsewhere):
            for slot in tuple(self._slots.values()):
                if slot.number != message.slot:
                    slot.note_steps_elsewhere(message.taken)
        elif isinstance(message, OwnerChanged):
            if (slot := self._slots.get(message.slot)) is not None:  # else it has no sessions of that owner
                slot.note_owner(message.owner)
        elif isinstance(message, EncodeTexts):
            self._texts.put(message)
        elif isinstance(message, Load | LoadEncoder):
            self._jobs.put(message)
        elif isinstance(message, Stop):
            self._is_stopping = True
            self._jobs.put(message)
        else:
            raise CodecError(f"{type(message).__name__} came on the way for what goes ahead")

    def _pass_on(self, message: Events | CloseAhead) -> None:
        slot = self._slots.get(message.slot)
        if slot is not None:  # else the slot has ended, and the gateway is being told
            slot.take(message)

    @staticmethod
    def _receive(socket: zmq.Socket[bytes]) -> ToEngine | None:
        try:
            data = socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return None
        return TO_ENGINE.decode(data)


def ended_by(error: BaseException | None) -> Ended:
    """The last message of the process. error: None after Stop."""
    return Ended("" if error is None else sendable(f"{type(error).__name__}: {error}"))


def _encoded(ready: Ready, built: Built) -> bytes:
    """Encode a Ready message. Raises SettingError if text from the model's folder is not valid Unicode."""
    try:
        return TO_GATEWAY.encode(ready)
    except CodecError as error:
        built.engine.lease.leave()
        raise SettingError(f"what the model's folder says of it cannot be told: {error}") from error
