"""Every value that crosses between processes is decoded as it was encoded; anything else is refused."""

from __future__ import annotations

import types
import typing
from dataclasses import dataclass, fields, is_dataclass, make_dataclass
from enum import Enum

import msgpack
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from motiongen_server.config import ServerConfig
from motiongen_server.engine_process import messages
from motiongen_server.engine_process.codec import DTYPES, Codec, CodecError
from motiongen_server.engine_process.messages import GREETING, SCHEMA, TO_ENGINE, TO_GATEWAY

PLAIN = {
    int: st.integers(-(2**63), 2**64 - 1),
    float: st.floats(),
    str: st.text(),
    bool: st.booleans(),
    bytes: st.binary(),
    type(None): st.none(),
}
FLOATS = arrays.arrays(np.float32, arrays.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=5))


def values(hint: typing.Any) -> st.SearchStrategy[typing.Any]:
    """Any value of a type, derived from its hints independently of the codec."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint in PLAIN:
        return PLAIN[hint]
    if hint is ServerConfig:
        ports, hosts, switches = st.integers(0, 65535), st.text(), st.booleans()
        # with `insecure`, any host is accepted
        return st.builds(ServerConfig, port=ports, host=hosts, reflection=switches, insecure=st.just(True))
    if origin is np.ndarray:
        return FLOATS
    if origin is tuple and arguments[-1] is not Ellipsis:
        return st.tuples(*map(values, arguments))
    if origin in (tuple, list, typing.get_origin(typing.Sequence[int])):
        items = st.lists(values(arguments[0]), max_size=3)
        return items if origin is list else items.map(tuple)
    if origin in (dict, typing.get_origin(typing.Mapping[int, int])):
        return st.dictionaries(values(arguments[0]), values(arguments[1]), max_size=3)
    if arguments:
        return st.one_of(*map(values, arguments))
    if issubclass(hint, Enum):
        return st.sampled_from(hint)
    return st.builds(hint, **{name: values(each) for name, each in typing.get_type_hints(hint).items()})


def same(left: object, right: object) -> bool:
    """Equal in type and content, arrays and NaN too."""
    if type(left) is not type(right):
        return False
    if isinstance(left, np.ndarray):
        assert isinstance(right, np.ndarray)
        return left.dtype == right.dtype and left.shape == right.shape and left.tobytes() == right.tobytes()
    if is_dataclass(left):
        return all(same(getattr(left, field.name), getattr(right, field.name)) for field in fields(left))
    if isinstance(left, (list, tuple)):
        assert isinstance(right, (list, tuple))
        return len(left) == len(right) and all(map(same, left, right))
    return repr(left) == repr(right)  # NaN is NaN, and 0.0 is not -0.0


CODECS = {
    **dict.fromkeys(typing.get_args(messages.ToEngine), TO_ENGINE),
    **dict.fromkeys(typing.get_args(messages.ToGateway), TO_GATEWAY),
    messages.Greeting: GREETING,
}


@pytest.mark.parametrize("kind", CODECS, ids=lambda kind: kind.__name__)
@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_every_message_is_decoded_as_it_was_encoded(kind: type, data: st.DataObject) -> None:
    message = data.draw(values(kind))
    assert same(CODECS[kind].decode(CODECS[kind].encode(message)), message)


@pytest.mark.parametrize("name", ["Event", "Output", "Constraint"])
def test_codecs_know_all_values_of_the_engine(name: str) -> None:
    import motiongen_server.engine.types as engine_types

    known = "\n".join(TO_ENGINE.table + TO_GATEWAY.table)
    for kind in typing.get_args(getattr(engine_types, name)):
        assert kind.__name__ in known


@dataclass(frozen=True)
class Row:
    values: NDArray[np.float32]


@dataclass(frozen=True)
class Wider:
    values: NDArray[np.float32]
    more: int = 0


ROWS = Codec(Row)


@pytest.mark.parametrize("dtype", DTYPES)
def test_arrays_keep_type_and_shape_whatever_their_memory_layout(dtype: np.dtype[typing.Any]) -> None:
    plain = np.arange(12).reshape(3, 4).astype(dtype)
    for array in (plain, plain.T, plain[:, ::2], plain[::-1], plain[:0], plain.astype(dtype.newbyteorder(">"))):
        decoded = ROWS.decode(ROWS.encode(Row(array))).values
        assert (decoded.dtype, decoded.shape) == (dtype, array.shape)
        assert (decoded == array).all()
        assert decoded.flags.writeable


def test_numpy_number_in_a_field_is_decoded_as_a_plain_number() -> None:
    codec = Codec(Wider)
    decoded = codec.decode(codec.encode(Wider(np.zeros(1, np.float32), np.int64(7))))  # type: ignore[arg-type]
    assert decoded.more == 7
    assert type(decoded.more) is int


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        b"\x00",
        b"\x92\x07\x90",
        b"\x92\xff\x90",
        ROWS.encode(Row(np.zeros(3, np.float32)))[:-2],
        msgpack.packb((0, ((len(DTYPES), (1,), bytes(4)),))),
        msgpack.packb((0, ((0, (2,), bytes(4)),))),
        msgpack.packb((0, ((0, (1,), bytes(4)), 7))),
    ],
    ids=[
        "nothing", "no msgpack", "no message", "no such message", "a negative number", "half", "no such type",
        "another shape", "a field too many",
    ],
)  # fmt: skip
def test_bytes_that_are_no_message_are_refused(data: bytes) -> None:
    with pytest.raises(CodecError, match="no message of schema"):
        ROWS.decode(data)


@pytest.mark.parametrize(
    "message", [Row(np.array(["a"])), Row(None), "walk"], ids=["text in an array", "no array", "no message"]
)
def test_values_that_fit_no_type_are_refused(message: typing.Any) -> None:
    with pytest.raises(CodecError, match="cannot encode"):
        ROWS.encode(message)
    assert len(ROWS.decode(ROWS.encode(Row(np.zeros(3, np.float32)))).values) == 3, "the next message is not affected"


@pytest.mark.parametrize("more", [2**64, "\ud800", object()], ids=["a large number", "no Unicode", "an object"])
def test_value_that_no_message_can_hold_is_refused(more: typing.Any) -> None:
    with pytest.raises(CodecError, match="cannot encode Wider"):
        Codec(Wider).encode(Wider(np.zeros(1, np.float32), more))


def test_arrays_are_copies_or_views_of_the_message_as_asked() -> None:
    data = ROWS.encode(Row(np.arange(3, dtype=np.float32)))
    copied, viewed = ROWS.decode(data).values, Codec(Row, writable=False).decode(data).values
    assert (copied == viewed).all()
    assert copied.base is None
    assert not viewed.flags.owndata


class Red(Enum):
    RED = 1


class Pair(typing.NamedTuple):
    one: int
    two: str


def holder_of(kind: type) -> type[typing.Any]:
    """A message with a field of that type, which is called the same whatever it is."""
    return make_dataclass("Holder", [("held", kind)])


@pytest.mark.parametrize("held", [Red.RED, Pair(1, "a")], ids=repr)
def test_enums_and_named_tuples_are_decoded_as_their_own_types(held: typing.Any) -> None:
    holder = holder_of(type(held))
    decoded = Codec(holder).decode(Codec(holder).encode(holder(held))).held
    assert (type(decoded), decoded) == (type(held), held)


def test_named_tuple_with_an_array_is_an_error_when_the_codec_is_made() -> None:
    class Named(typing.NamedTuple):
        values: NDArray[np.float32]

    with pytest.raises(TypeError, match="Named may hold plain values only"):
        Codec(holder_of(Named))


def test_field_of_an_unsupported_type_is_an_error_when_the_codec_is_made() -> None:
    @dataclass
    class Odd:
        call: typing.Callable[[], None]

    with pytest.raises(TypeError, match="cannot cross between processes"):
        Codec(Odd)


class Alias:
    """A stand-in for `NDArray` of numpy 2.5 and later, which is a type alias of its own kind."""

    __value__ = NDArray[np.float32]

    def __getitem__(self, arguments: typing.Any) -> types.GenericAlias:
        return types.GenericAlias(typing.cast(type, self), arguments)

    def __repr__(self) -> str:
        return "NDArray"


def test_schema_of_arrays_does_not_depend_on_the_numpy_version() -> None:
    @dataclass
    class Told:
        values: NDArray[np.float32]
        more: tuple[NDArray[np.float32], ...]

    before = Codec(Told)
    alias = Alias()[np.float32]
    Told.__annotations__ = {"values": alias, "more": tuple[alias, ...]}  # type: ignore[valid-type]
    after = Codec(Told)
    assert after.schema == before.schema
    told = Told(np.arange(3, dtype=np.float32), (np.ones(2, np.float32),))
    assert np.array_equal(before.decode(after.encode(told)).values, told.values)


def test_schema_changes_with_fields_and_order_of_messages() -> None:
    assert Codec(Row).schema == ROWS.schema
    assert Codec(Wider).schema != ROWS.schema
    assert Codec(Row, Wider).schema != Codec(Wider, Row).schema
    kinds = [
        Enum("Kind", {"RED": 1}), Enum("Kind", {"RED": 2}), Enum("Kind", {"BLUE": 1}),
        typing.NamedTuple("Kind", [("one", int)]), typing.NamedTuple("Kind", [("one", str)]),
    ]  # fmt: skip
    assert len({Codec(holder_of(kind)).schema for kind in kinds}) == len(kinds)
    assert f"{TO_ENGINE.schema}-{TO_GATEWAY.schema}" == SCHEMA
