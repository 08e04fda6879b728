"""Values <-> bytes (msgpack), by the fields of their classes. Encoders and decoders are made from the type hints.

A dataclass becomes the array of its fields, in a union preceded by its number there; an array becomes (type, shape, raw
little-endian bytes); an enum becomes its number. Types come only from the hints, never from the bytes, so no object can
be made that the table does not name. `schema` is equal if both ends have the same table.
"""

from __future__ import annotations

import hashlib
import re
import threading
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from operator import attrgetter
from typing import Any, Generic, TypeVar

import msgpack
import numpy as np

Message = TypeVar("Message")
Convert = Callable[[Any], Any]

PLAIN = (bool, int, float, str, bytes, type(None))
DTYPES = tuple(np.dtype(name) for name in ("<f4", "<f8", "<i4", "<i8", "|u1", "|b1"))
_DTYPE_NUMBERS = {dtype: number for number, dtype in enumerate(DTYPES)}
_ARRAY = re.compile(
    r"NDArray\[(?P<new>[^\]]+)\]|numpy\.ndarray\[(?:[\w.]+|tuple\[[^\]]*\]), numpy\.dtype\[(?P<old>[^\]]+)\]\]"
)
_ARRAY_SPELLED = "numpy.ndarray[tuple[typing.Any, ...], numpy.dtype[{}]]"
_SEQUENCES: dict[Any, Callable[[Any], Any]] = {tuple: tuple, list: list, Sequence: tuple}
_MAPPINGS = (dict, Mapping)


class CodecError(ValueError):
    """Bytes that are not a message of the table, or a value that its field's type does not allow."""


class Codec(Generic[Message]):
    """Encodes and decodes the messages of one union, with everything they hold."""

    def __init__(self, *messages: type[Message], writable: bool = True) -> None:
        """writable: whether decoded arrays are writable copies, or views of the message's bytes.

        Raises TypeError for a field whose type the codec does not support.
        """
        table = _Table(_decode_array if writable else _view_array)
        self._encode, self._decode = table.union(messages)
        # Kept, because a new buffer of a megabyte for each message costs more than filling it.
        self._packer = msgpack.Packer(default=_pack_number)
        self._packing = threading.Lock()
        self.table = table.lines
        """Messages, fields and types, in order, for people to read."""
        self.schema = hashlib.sha256("\n".join(table.lines).encode()).hexdigest()[:16]
        """A short name of the table."""

    def encode(self, message: Message) -> bytes:
        """Raises CodecError for a value that its field's type does not allow."""
        try:
            content = self._encode(message)
            with self._packing:
                packed: bytes = self._packer.pack(content)
        except (TypeError, ValueError, OverflowError, AttributeError, KeyError) as error:
            raise CodecError(f"cannot encode {type(message).__name__}: {error}") from error
        return packed

    def decode(self, data: bytes | memoryview) -> Message:
        """Raises CodecError for anything that `encode` did not make with the same schema, or with an earlier one that
        differs only in fields with defaults added since at the ends of classes.
        """
        try:
            message: Message = self._decode(msgpack.unpackb(data, use_list=False, strict_map_key=False))
        except (TypeError, ValueError, IndexError, KeyError) as error:
            raise CodecError(f"{len(data)} bytes are no message of schema {self.schema}: {error}") from error
        return message


def sendable(text: str) -> str:
    """A text that any message can hold: what is not valid Unicode, as in some file names, is escaped."""
    return text.encode("utf-8", "backslashreplace").decode()


def _pack_number(value: object) -> object:
    """Converts numpy's numbers, which msgpack does not know."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no place here")


def _encode_array(array: Any) -> tuple[int, tuple[int, ...], Any]:
    dtype = array.dtype if array.dtype in _DTYPE_NUMBERS else array.dtype.newbyteorder("<")
    data = np.ascontiguousarray(array, dtype).data if array.size else b""
    return _DTYPE_NUMBERS[dtype], array.shape, data


def _view_array(value: Any) -> Any:
    number, shape, data = value
    return np.frombuffer(data, DTYPES[number]).reshape(shape)


def _decode_array(value: Any) -> Any:
    return _view_array(value).copy()  # torch accepts only writable arrays


class _Table:
    """Converters by type. None stands for "unchanged", so that a plain field costs nothing."""

    def __init__(self, decode_array: Convert) -> None:
        self._decode_array = decode_array
        self.lines: list[str] = []
        self._structs: dict[type, tuple[Convert, Convert]] = {}

    def of(self, hint: Any) -> tuple[Convert | None, Convert | None]:
        """The encoder and the decoder of a type."""
        origin, arguments = typing.get_origin(hint), typing.get_args(hint)
        if hint in PLAIN:
            return None, None
        if _is_array(hint):
            return _encode_array, self._decode_array
        if origin in (typing.Union, types.UnionType):
            return self._optional(arguments)
        if origin in _SEQUENCES:
            return self._sequence(_SEQUENCES[origin], arguments)
        if origin in _MAPPINGS:
            return self._mapping(arguments)
        if isinstance(hint, type) and issubclass(hint, Enum):
            self._note(hint, ", ".join(f"{member.name}={member.value}" for member in hint))
            is_plain = issubclass(hint, int | str)  # msgpack packs it unchanged
            return None if is_plain else attrgetter("value"), hint._value2member_map_.__getitem__
        if isinstance(hint, type) and hasattr(hint, "_fields"):
            return self._named_tuple(hint)
        if is_dataclass(hint) and isinstance(hint, type):
            return self.struct(hint)
        raise TypeError(f"{hint} cannot cross between processes; give it a place in its codec")

    def _note(self, kind: type, content: str) -> None:
        line = f"{kind.__name__}: {content}"
        if line not in self.lines:
            self.lines.append(line)

    def struct(self, kind: type) -> tuple[Convert, Convert]:
        """A dataclass or a named tuple as the tuple of its fields."""
        if kind in self._structs:
            return self._structs[kind]
        hints = typing.get_type_hints(kind)
        names = [field.name for field in fields(kind)] if is_dataclass(kind) else list(hints)
        self._note(kind, ", ".join(f"{name}: {_spelled(hints[name])}" for name in names))
        pairs = [self.of(hints[name]) for name in names]
        self._structs[kind] = (
            _struct_encoder(names, [pair[0] for pair in pairs]),
            _struct_decoder(kind, [pair[1] for pair in pairs]),
        )
        return self._structs[kind]

    def union(self, kinds: Sequence[type]) -> tuple[Convert, Convert]:
        """One of several dataclasses: (its number in the list, its fields)."""
        self.lines.append("one of " + ", ".join(kind.__name__ for kind in kinds))
        pairs = [self.struct(kind) for kind in kinds]
        encoders = {kind: (number, pair[0]) for number, (kind, pair) in enumerate(zip(kinds, pairs, strict=True))}
        decoders = {number: pair[1] for number, pair in enumerate(pairs)}

        def encode(value: Any) -> Any:
            number, encode_fields = encoders[type(value)]
            return number, encode_fields(value)

        def decode(value: Any) -> Any:
            number, content = value
            return decoders[number](content)

        return encode, decode

    def _optional(self, arguments: tuple[Any, ...]) -> tuple[Convert | None, Convert | None]:
        others = [argument for argument in arguments if argument is not type(None)]
        if all(other in PLAIN for other in others):
            return None, None
        encode, decode = self.of(others[0]) if len(others) == 1 else self.union(others)
        if len(others) == len(arguments):
            return encode, decode
        return _unless_none(encode), _unless_none(decode)

    def _sequence(self, make: Convert, arguments: tuple[Any, ...]) -> tuple[Convert | None, Convert | None]:
        if make is tuple and arguments[-1] is not Ellipsis and len(arguments) > 1:
            pairs = [self.of(argument) for argument in arguments]
            return _fields_converter([pair[0] for pair in pairs]), _fields_converter([pair[1] for pair in pairs])
        encode, decode = self.of(arguments[0])
        return _each(encode, tuple), _each(decode, make)

    def _mapping(self, arguments: tuple[Any, ...]) -> tuple[Convert, Convert]:
        keys, values = self.of(arguments[0]), self.of(arguments[1])
        encode, decode = _fields_converter([keys[0], values[0]]), _fields_converter([keys[1], values[1]])
        return _items_encoder(encode), _items_decoder(decode)

    def _named_tuple(self, kind: Any) -> tuple[Convert | None, Convert]:
        hints = typing.get_type_hints(kind)
        self._note(kind, ", ".join(f"{name}: {_spelled(hints[name])}" for name in kind._fields))
        if not all(hint in PLAIN for hint in hints.values()):
            raise TypeError(f"{kind.__name__} may hold plain values only")
        return None, kind._make


def _is_array(hint: Any) -> bool:
    """Whether this is an `NDArray[...]`, which from numpy 2.5 on is a type alias with its type in `__value__`."""
    origin = typing.get_origin(hint)
    return np.ndarray in (origin, typing.get_origin(getattr(origin, "__value__", None)))


def _spelled(hint: Any) -> str:
    """A type's name, the same for every version of numpy, since servers read each other's records."""
    if isinstance(hint, type) and not typing.get_args(hint):
        return hint.__name__
    return _ARRAY.sub(lambda found: _ARRAY_SPELLED.format(found["new"] or found["old"]), str(hint))


def _struct_encoder(names: list[str], encoders: list[Convert | None]) -> Convert:
    if not names:
        return lambda value: ()
    special = [(index, convert) for index, convert in enumerate(encoders) if convert is not None]
    get: Convert = attrgetter(*names) if len(names) > 1 else _alone(attrgetter(names[0]))
    if not special:
        return get

    def encode(value: Any) -> Any:
        content = list(get(value))
        for index, convert in special:
            content[index] = convert(content[index])
        return content

    return encode


def _alone(get: Convert) -> Convert:
    return lambda value: (get(value),)


def _struct_decoder(kind: Callable[..., Any], decoders: list[Convert | None]) -> Convert:
    special = [(index, convert) for index, convert in enumerate(decoders) if convert is not None]
    if not special:
        return lambda content: kind(*content)

    def decode(content: Any) -> Any:
        values = list(content)
        for index, convert in special:
            if index < len(values):  # else it was written before this field existed
                values[index] = convert(values[index])
        return kind(*values)

    return decode


def _fields_converter(converters: list[Convert | None]) -> Convert:
    """For a tuple of fixed length."""
    return lambda values: tuple(
        value if convert is None else convert(value) for value, convert in zip(values, converters, strict=True)
    )


def _items_encoder(encode: Convert) -> Convert:
    return lambda mapping: [encode(item) for item in mapping.items()]


def _items_decoder(decode: Convert) -> Convert:
    return lambda items: dict(map(decode, items))


def _each(convert: Convert | None, make: Convert) -> Convert | None:
    if convert is None:
        return None if make is tuple else make
    return lambda values: make([convert(value) for value in values])


def _unless_none(convert: Convert | None) -> Convert | None:
    return None if convert is None else lambda value: None if value is None else convert(value)
