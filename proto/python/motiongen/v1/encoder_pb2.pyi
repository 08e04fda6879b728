from motiongen.v1 import motion_pb2 as _motion_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class GetTextEncoderRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GetTextEncoderResponse(_message.Message):
    __slots__ = ("text_encoder", "width", "max_texts", "max_characters")
    TEXT_ENCODER_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    MAX_TEXTS_FIELD_NUMBER: _ClassVar[int]
    MAX_CHARACTERS_FIELD_NUMBER: _ClassVar[int]
    text_encoder: str
    width: int
    max_texts: int
    max_characters: int
    def __init__(self, text_encoder: _Optional[str] = ..., width: _Optional[int] = ..., max_texts: _Optional[int] = ..., max_characters: _Optional[int] = ...) -> None: ...

class EncodeTextsRequest(_message.Message):
    __slots__ = ("texts", "text_encoder")
    TEXTS_FIELD_NUMBER: _ClassVar[int]
    TEXT_ENCODER_FIELD_NUMBER: _ClassVar[int]
    texts: _containers.RepeatedScalarFieldContainer[str]
    text_encoder: str
    def __init__(self, texts: _Optional[_Iterable[str]] = ..., text_encoder: _Optional[str] = ...) -> None: ...

class EncodeTextsResponse(_message.Message):
    __slots__ = ("embeddings",)
    EMBEDDINGS_FIELD_NUMBER: _ClassVar[int]
    embeddings: _containers.RepeatedCompositeFieldContainer[_motion_pb2.TextEmbedding]
    def __init__(self, embeddings: _Optional[_Iterable[_Union[_motion_pb2.TextEmbedding, _Mapping]]] = ...) -> None: ...
