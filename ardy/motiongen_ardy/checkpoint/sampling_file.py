"""SamplingOptions <-> the mapping in `sampling.yaml` of a checkpoint folder."""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar

from motiongen_ardy.checkpoint.config_section import Section
from motiongen_ardy.model.config import ConfigError, GuidanceMode
from motiongen_ardy.model.sampling.options import CheckedOptions, SamplingOptions, released_options

SAMPLING_FILE = "sampling.yaml"
Group = TypeVar("Group", bound=CheckedOptions)


def read_options(content: object, mode: GuidanceMode) -> SamplingOptions:
    """The options in a parsed file; those that it does not name are as released. mode: from `config.yaml`.

    Raises ConfigError listing every problem: unknown keys with the known ones, and values outside their range.
    """
    problems: list[str] = []
    options = _read_group(released_options(mode), content, SAMPLING_FILE, problems)
    if problems:
        raise ConfigError(problems)
    return options


def write_options(options: SamplingOptions) -> dict[str, Any]:
    """The mapping that `read_options` reads as these options."""
    return asdict(options)


def _read_group(default: Group, content: object, where: str, problems: list[str]) -> Group:
    """A group of options: the values of a mapping over the defaults; problems are added to `problems`."""
    section = Section(content, where, problems)
    names = [one.name for one in fields(default)]  # type: ignore[arg-type]
    section.refuse_unknown(names)
    values: dict[str, Any] = {}
    for name in names:
        held = getattr(default, name)
        if name not in section:
            values[name] = held
        elif is_dataclass(held) and isinstance(held, CheckedOptions):
            values[name] = _read_group(held, section.content[name], f"{where}.{name}", problems)
        else:
            values[name] = section.content[name]
    try:
        return type(default)(**values)
    except ConfigError as error:
        problems += [f"{where}.{problem}" for problem in error.problems]
        return default
