"""The protos keep the STANDARD rules of buf (names, directories, enums, requests) and comment every element."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
    ServiceDescriptorProto,
)
from grpc_tools import protoc

PASCAL = re.compile(r"[A-Z][A-Za-z0-9]*")
SNAKE = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
UPPER_SNAKE = re.compile(r"[A-Z][A-Z0-9]*(_[A-Z0-9]+)*")

# numbers of the repeated fields in descriptor.proto: they make up the paths of SourceCodeInfo
FILE_MESSAGES, FILE_ENUMS, FILE_SERVICES = 4, 5, 6
MESSAGE_FIELDS, ENUM_VALUES, SERVICE_METHODS = 2, 2, 2


def violations(files: FileDescriptorSet) -> list[str]:
    """Every breach of the rules, one line each."""
    found = [line for file in files.file for line in file_violations(file)]
    types = Counter(
        type_ for file in files.file for s in file.service for m in s.method for type_ in (m.input_type, m.output_type)
    )
    return found + [f"{name}: is the request or response of {n} methods" for name, n in types.items() if n > 1]


def file_violations(file: FileDescriptorProto) -> Iterator[str]:
    folder, _, name = file.name.rpartition("/")
    if file.package.replace(".", "/") != folder:
        yield f"{file.name}: package {file.package!r} is not its folder"
    if not re.search(r"\.v[1-9][0-9]*$", file.package):
        yield f"{file.name}: package {file.package!r} has no version suffix"
    if not SNAKE.fullmatch(name.removesuffix(".proto")):
        yield f"{file.name}: file names are lower_snake_case"
    if file.syntax != "proto3":
        yield f"{file.name}: syntax is not proto3"
    if file.public_dependency or file.weak_dependency:
        yield f"{file.name}: public and weak imports are not allowed"
    if file.message_type and any(m.nested_type or m.enum_type for m in file.message_type):
        yield f"{file.name}: nested types are not used here"
    commented = {tuple(place.path) for place in file.source_code_info.location if place.leading_comments.strip()}
    for index, message in enumerate(file.message_type):
        yield from message_violations(message, commented, (FILE_MESSAGES, index))
    for index, enum in enumerate(file.enum_type):
        yield from enum_violations(enum, commented, (FILE_ENUMS, index))
    for index, service in enumerate(file.service):
        yield from service_violations(service, commented, (FILE_SERVICES, index))


def message_violations(
    message: DescriptorProto, commented: set[tuple[int, ...]], path: tuple[int, ...]
) -> Iterator[str]:
    if not PASCAL.fullmatch(message.name):
        yield f"{message.name}: message names are PascalCase"
    if path not in commented:
        yield f"{message.name}: no comment"
    for index, field in enumerate(message.field):
        if not SNAKE.fullmatch(field.name):
            yield f"{message.name}.{field.name}: field names are lower_snake_case"
        if (*path, MESSAGE_FIELDS, index) not in commented:
            yield f"{message.name}.{field.name}: no comment"
    for oneof in message.oneof_decl:
        if not SNAKE.fullmatch(oneof.name.removeprefix("_")):
            yield f"{message.name}.{oneof.name}: oneof names are lower_snake_case"


def enum_violations(enum: EnumDescriptorProto, commented: set[tuple[int, ...]], path: tuple[int, ...]) -> Iterator[str]:
    prefix = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", enum.name).upper() + "_"
    if not PASCAL.fullmatch(enum.name):
        yield f"{enum.name}: enum names are PascalCase"
    if path not in commented:
        yield f"{enum.name}: no comment"
    if enum.options.allow_alias:
        yield f"{enum.name}: aliases are not allowed"
    if (enum.value[0].number, enum.value[0].name) != (0, f"{prefix}UNSPECIFIED"):
        yield f"{enum.name}: the first value must be {prefix}UNSPECIFIED = 0"
    for index, value in enumerate(enum.value):
        if not value.name.startswith(prefix) or not UPPER_SNAKE.fullmatch(value.name):
            yield f"{enum.name}.{value.name}: values are {prefix}UPPER_SNAKE_CASE"
        if (*path, ENUM_VALUES, index) not in commented:
            yield f"{enum.name}.{value.name}: no comment"


def service_violations(
    service: ServiceDescriptorProto, commented: set[tuple[int, ...]], path: tuple[int, ...]
) -> Iterator[str]:
    if not PASCAL.fullmatch(service.name) or not service.name.endswith("Service"):
        yield f"{service.name}: service names are PascalCase and end in Service"
    if path not in commented:
        yield f"{service.name}: no comment"
    for index, method in enumerate(service.method):
        name = f"{service.name}.{method.name}"
        if not PASCAL.fullmatch(method.name):
            yield f"{name}: method names are PascalCase"
        if (*path, SERVICE_METHODS, index) not in commented:
            yield f"{name}: no comment"
        for given, suffix in ((method.input_type, "Request"), (method.output_type, "Response")):
            if given.rsplit(".", 1)[1] not in (method.name + suffix, service.name + method.name + suffix):
                yield f"{name}: {given} should be {method.name}{suffix}"


def test_our_protos_keep_the_rules(generator: ModuleType) -> None:
    assert violations(generator.descriptors()) == []


GOOD = """
syntax = "proto3";
package shop.v1;
// A.
enum Colour {
  // B.
  COLOUR_UNSPECIFIED = 0;
}
// C.
message BuyRequest {
  // D.
  Colour colour = 1;
}
// E.
message BuyResponse {}
// F.
service ShopService {
  // G.
  rpc Buy(BuyRequest) returns (BuyResponse);
}
"""


def compile_proto(text: str, folder: Path) -> FileDescriptorSet:
    (folder / "shop/v1").mkdir(parents=True)
    (folder / "shop/v1/shop.proto").write_text(text)
    target = folder / "set.binpb"
    arguments = [
        f"--proto_path={folder}",
        f"--descriptor_set_out={target}",
        "--include_source_info",
        "shop/v1/shop.proto",
    ]
    assert protoc.main(["protoc", *arguments]) == 0
    return FileDescriptorSet.FromString(target.read_bytes())


def test_a_proto_that_keeps_the_rules_passes(tmp_path: Path) -> None:
    assert violations(compile_proto(GOOD, tmp_path)) == []


@pytest.mark.parametrize(
    ("given", "broken", "complaint"),
    [
        ("package shop.v1;", "package store.v1;", "is not its folder"),
        ("package shop.v1;", "package shop;", "no version suffix"),
        ('syntax = "proto3";', 'syntax = "proto2";', "not proto3"),
        ("COLOUR_UNSPECIFIED", "UNSPECIFIED", "must be COLOUR_UNSPECIFIED"),
        ("colour = 1", "theColour = 1", "lower_snake_case"),
        ("// D.", "", "BuyRequest.colour: no comment"),
        ("// B.", "", "Colour.COLOUR_UNSPECIFIED: no comment"),
        ("// G.", "", "ShopService.Buy: no comment"),
        ("service ShopService", "service Shop", "end in Service"),
        ("returns (BuyResponse)", "returns (BuyRequest)", "should be BuyResponse"),
        ("returns (BuyResponse)", "returns (BuyRequest)", "of 2 methods"),
    ],
)
def test_a_breach_is_reported(given: str, broken: str, complaint: str, tmp_path: Path) -> None:
    text = GOOD.replace(given, broken)
    if "proto2" in broken:
        text = text.replace("  Colour colour", "  optional Colour colour")
    found = violations(compile_proto(text, tmp_path))
    assert any(complaint in line for line in found), found
