"""Server reflection in both versions that tools use, with look-up of methods by name.

The reflection library serves v1alpha only; the messages of v1 are the same, byte for byte, in another package. And the
runtime's descriptor pool cannot find a method by its name, which is what `grpcurl describe` and `ghz` ask for.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterable
from typing import TypeVar, cast

import grpc
import grpc.aio
from google.protobuf import descriptor_pb2, descriptor_pool
from google.protobuf.descriptor import Descriptor, FieldDescriptor, FileDescriptor
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from grpc_reflection.v1alpha import reflection, reflection_pb2

from motiongen_server.rpc.budgets.call_places import CallPlaces
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.peers import Peers
from motiongen_server.rpc.budgets.stream_budget import CALL_COST
from motiongen_server.rpc.calls.context import CallContext, streaming_method
from motiongen_server.rpc.calls.requests import Requests, parsed_as
from motiongen_server.rpc.errors.calls import request_too_long
from motiongen_server.rpc.errors.too_many_calls import too_much_reflection
from motiongen_server.rpc.grpc_server import serve_methods
from motiongen_server.rpc.limits import PeerLimits

V1ALPHA = reflection.SERVICE_NAME
V1 = V1ALPHA.replace("v1alpha", "v1")

T = TypeVar("T")
MOST_CALLS = 32
MOST_OF_AN_ADDRESS = 12
CALL_S = 30.0
PACE_S = 0.005
"""After each answer."""
MOST_QUESTION_BYTES = 1024
"""Questions are names; an answer repeats its question."""
LIMITS = PeerLimits(calls_per_second=100.0, bytes_per_second=4_000_000.0)
"""Per address: calls and questions, and bytes of questions and answers. A tool asks some ten questions, whose answers
have 12 KB in all. The limits are separate, so reflection uses up nothing that an address may spend on anything else.
"""
_sleep = asyncio.sleep


def add_reflection(
    services: Iterable[str],
    server: grpc.aio.Server,
    requests: Requests | None = None,
    limits: PeerLimits = LIMITS,
) -> None:
    """Serve reflection of these services, and of itself.

    services: full names. requests: shared by all calls of that server. limits: of an address.
    """
    names = (*services, V1ALPHA, V1)
    # The library calls only these methods of a pool; the runtime's own class cannot be subclassed.
    servicer = reflection.aio.ReflectionServicer(names, pool=cast(DescriptorPool, _Descriptors()))
    requests, places, peers = requests or Requests(), CallPlaces(MOST_CALLS), Peers(limits)

    async def answer(call: CallContext) -> None:
        peer = _charged(peers, call)
        call.hold(places.take(peer.name, call.peer(), MOST_OF_AN_ADDRESS))
        try:
            async with asyncio.timeout(CALL_S):
                questions = _questions(call, peer)
                answers: AsyncIterator[Message] = servicer.ServerReflectionInfo(questions, call)  # type: ignore[arg-type, assignment]
                async for response in answers:
                    peer.bytes.charge(response.ByteSize(), time.monotonic())
                    await call.write(response)
                    await _sleep(max(PACE_S, _owed_s(peer, time.monotonic())))
        except TimeoutError:
            message = f"a call for reflection may last {CALL_S:g} s; start another"
            await call.abort(grpc.StatusCode.DEADLINE_EXCEEDED, message)

    handler = streaming_method(answer, requests)
    for name in (V1ALPHA, V1):
        serve_methods(server, name, {"ServerReflectionInfo": handler})


def _charged(peers: Peers, call: CallContext) -> Peer:
    """Charge a call to its peer, which is returned. Raises StreamRefused while the peer owes anything."""
    now = time.monotonic()
    peer = peers.find(call.peer(), now)
    if (owed_s := _owed_s(peer, now)) > 0:
        raise too_much_reflection(owed_s)
    peer.calls.charge(CALL_COST, now)
    return peer


def _owed_s(peer: Peer, now: float) -> float:
    """Seconds until the peer's questions and answers are paid."""
    return max(peer.calls.owed_s(now), peer.bytes.owed_s(now))


async def _questions(call: CallContext, peer: Peer) -> AsyncIterator[Message]:
    """The questions, each charged before it is looked at. Raises StreamRefused if one is malformed or too long."""
    while isinstance(data := await call.read(), bytes):  # else grpc.aio.EOF
        now = time.monotonic()
        peer.calls.charge(CALL_COST, now)
        peer.bytes.charge(len(data), now)
        if len(data) > MOST_QUESTION_BYTES:
            raise request_too_long(len(data), MOST_QUESTION_BYTES)
        yield parsed_as(reflection_pb2.ServerReflectionRequest, data)


class _Descriptors:
    """The program's descriptors and those of reflection v1, with a DescriptorPool's look-ups. All raise KeyError."""

    def __init__(self) -> None:
        v1 = DescriptorPool()
        v1.Add(_reflection_v1())
        self._pools = (descriptor_pool.Default(), v1)

    def FindFileByName(self, name: str) -> FileDescriptor:
        return self._first(lambda pool: pool.FindFileByName(name), name)

    def FindFileContainingSymbol(self, symbol: str) -> FileDescriptor:
        try:
            return self._first(lambda pool: pool.FindFileContainingSymbol(symbol), symbol)
        except KeyError:
            service, _, method = symbol.rpartition(".")
            found = self._first(lambda pool: pool.FindServiceByName(service), symbol)
            return found.methods_by_name[method].containing_service.file

    def FindMessageTypeByName(self, name: str) -> Descriptor:
        return self._first(lambda pool: pool.FindMessageTypeByName(name), name)

    def FindExtensionByNumber(self, message: Descriptor, number: int) -> FieldDescriptor:
        return self._first(lambda pool: pool.FindExtensionByNumber(message, number), f"{message.full_name}:{number}")

    def FindAllExtensions(self, message: Descriptor) -> list[FieldDescriptor]:
        return [found for pool in self._pools for found in pool.FindAllExtensions(message)]

    def _first(self, find: Callable[[DescriptorPool], T], name: str) -> T:
        for pool in self._pools:
            try:
                return find(pool)
            except KeyError:
                continue
        raise KeyError(name)


def _reflection_v1() -> descriptor_pb2.FileDescriptorProto:
    """The file of v1, which differs from that of v1alpha only in its package."""
    v1 = descriptor_pb2.FileDescriptorProto()
    reflection_pb2.DESCRIPTOR.CopyToProto(v1)
    v1.name, v1.package = "grpc/reflection/v1/reflection.proto", "grpc.reflection.v1"
    for message in v1.message_type:
        for field in message.field:
            if field.type_name:  # of a field that holds a message
                field.type_name = field.type_name.replace("v1alpha", "v1")
    for service in v1.service:
        for method in service.method:
            method.input_type = method.input_type.replace("v1alpha", "v1")
            method.output_type = method.output_type.replace("v1alpha", "v1")
    return v1
