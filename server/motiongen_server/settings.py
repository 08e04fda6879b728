"""Settings of a program, declared once as a frozen dataclass, from which flags, environment, help and checks follow."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Config = TypeVar("Config", bound="DataclassInstance")

ENVIRONMENT_PREFIX = "MOTIONGEN_"
_LINK_NAME = re.compile(r"_SERVICE_HOST$|_SERVICE_PORT(_\w+)?$|_PORT_\d+_(TCP|UDP|SCTP)(_PROTO|_PORT|_ADDR)?$")
_LINK_ADDRESS = re.compile(r"(tcp|udp|sctp)://")


class SettingError(ValueError):
    """A setting has an invalid value. The message names the setting, its value, and what is allowed."""


def setting(default: Any, meaning: str, least: float | None = None, most: float | None = None, **more: Any) -> Any:
    """A field of a program's settings: its default, its meaning, and what is allowed (a range, or `choices`).

    many: the flag may be repeated, and its values are joined with commas. kind: the type of a setting whose default is
    None; unset: what None stands for, in words. section: a heading of the help that begins at this setting.
    """
    return field(default=default, metadata={"meaning": meaning, "least": least, "most": most, **more})


def check_settings(config: DataclassInstance) -> None:
    """Raise SettingError for a value outside its range or choices."""
    for each in fields(config):
        check_setting(each.name, getattr(config, each.name), each.metadata)


def check_setting(name: str, value: Any, metadata: Mapping[str, Any]) -> None:
    """Raise SettingError unless the value is in its range and among its choices."""
    choices, least, most = metadata.get("choices"), metadata["least"], metadata["most"]
    if choices is not None and value not in choices:
        raise SettingError(f"{name} is {value!r}; it must be one of {', '.join(choices)}")
    if value is None and metadata.get("kind") is not None:
        return
    if least is not None and not least <= value <= most:
        raise SettingError(f"{name} is {value}; it must be from {least:.12g} to {most:.12g}")


@dataclass(frozen=True)
class Program(Generic[Config]):
    """A program and its settings. A flag wins over the environment, the environment over the default.

    prefix: of its environment variables. other_prefixes: variables that begin with one belong to another program.
    """

    kind: type[Config]
    command: str
    description: str
    prefix: str = ENVIRONMENT_PREFIX
    other_prefixes: tuple[str, ...] = ()

    def environment_name(self, name: str) -> str:
        """The environment variable of a setting."""
        return self.prefix + name.upper()

    def parse(self, arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> Config:
        """The configuration that flags and environment ask for. Raises SettingError; --help exits."""
        known = {each.name: each for each in fields(self.kind)}
        given_by_environment = self._own(os.environ if environment is None else environment)
        names = {self.environment_name(name) for name in known}  # in capitals: any other spelling is an error
        unknown = sorted(name for name in given_by_environment if name not in names)
        if unknown:
            raise SettingError(f"unknown environment settings {', '.join(unknown)}; `{self.command} --help` lists all")
        flags = vars(self._parser().parse_args(list(arguments)))
        values = {}
        for name, each in known.items():
            given = flags.get(name)
            if isinstance(given, list):
                given = ",".join(given)
            if given is None:
                given = given_by_environment.get(self.environment_name(name))
            if given is not None:
                values[name] = _converted(name, given, each.metadata.get("kind") or type(each.default))
        return self.kind(**values)

    def _own(self, environment: Mapping[str, str]) -> dict[str, str]:
        return {
            name: value
            for name, value in environment.items()
            if name.startswith(self.prefix)
            and not name.startswith(self.other_prefixes)
            and not is_service_link(name, value)
        }

    def _parser(self) -> argparse.ArgumentParser:
        parser = _Parser(
            prog=self.command,
            usage="%(prog)s [-h] [--SETTING VALUE ...]",
            description=self.description,
            epilog="Every setting also has an environment variable; a flag wins over it.",
        )
        section: argparse._ArgumentGroup | argparse.ArgumentParser = parser
        for each in fields(self.kind):
            metadata = each.metadata
            if "section" in metadata:
                section = parser.add_argument_group(metadata["section"])
            is_switch = isinstance(each.default, bool)
            section.add_argument(
                f"--{each.name.replace('_', '-')}",
                metavar="true|false" if is_switch else (metadata.get("kind") or type(each.default)).__name__.upper(),
                action="append" if metadata.get("many") else "store",
                nargs="?" if is_switch else None,
                const="true" if is_switch else None,
                help=f"{_help(each.default, metadata)} [{self.environment_name(each.name)}]",
            )
        return parser


def _help(default: Any, metadata: Mapping[str, Any]) -> str:
    """A setting's meaning, what is allowed, and its default as it would be given on the command line."""
    allowed = ""
    if metadata.get("choices"):
        allowed = f"; one of {', '.join(metadata['choices'])}"
    elif metadata["least"] is not None:
        allowed = f"; {metadata['least']:.12g} to {metadata['most']:.12g}"
    shown = str(default) or "none"
    if default is None:
        shown = metadata["unset"]
    elif isinstance(default, bool):
        shown = str(default).lower()
    elif isinstance(default, float):
        shown = f"{default:.12g}"
    return f"{metadata['meaning']}{allowed} (default {shown})"


def is_service_link(name: str, value: str) -> bool:
    """Whether Kubernetes sets a variable because there is a Service named motiongen or motiongen-...

    For example MOTIONGEN_SERVICE_HOST, or MOTIONGEN_PORT=tcp://10.0.0.7:50051, which has the name of a setting.
    """
    return name.startswith(ENVIRONMENT_PREFIX) and bool(
        _LINK_NAME.search(name) or (name.endswith("_PORT") and _LINK_ADDRESS.match(value))
    )


def _converted(name: str, given: str, kind: type) -> Any:
    if kind is bool:
        words = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
        if given.lower() not in words:
            raise SettingError(f"{name} is {given!r}; it must be true or false")
        return words[given.lower()]
    if kind is str and not _is_text(given):
        raise SettingError(f"{name} is {given!r}; it must be text in UTF-8")
    try:
        return kind(given)
    except ValueError:
        what = "a whole number" if kind is int else "a number"
        raise SettingError(f"{name} is {given!r}; it must be {what}") from None


def _is_text(given: str) -> bool:
    """Whether it is valid text. The system also passes bytes that are not UTF-8, which cannot be sent to other
    processes.
    """
    try:
        given.encode()
    except UnicodeEncodeError:
        return False
    return True


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> Any:
        raise SettingError(f"{message}; `{self.prog} --help` lists all settings")
