"""Reads one mapping of a `config.yaml`: every value is checked, and all problems are collected."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from reprlib import Repr
from typing import Any

_SHORT = Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 80
_SHORT.maxlevel, _SHORT.maxdict, _SHORT.maxlist = 3, 4, 6


def shown(value: object) -> str:
    """A value as it is shown in a message: short, however large it is."""
    return _SHORT.repr(value)


class Section:
    """A mapping and its place in the file. Getters add what is wrong to `problems`, and then return None."""

    def __init__(self, content: object, where: str, problems: list[str]) -> None:
        self.where = where
        self.problems = problems
        self.content: Mapping[Any, Any] = {}
        if isinstance(content, Mapping):
            self.content = content
        else:
            problems.append(f"{where} is {shown(content)}; it must be a mapping")

    def __contains__(self, key: str) -> bool:
        return key in self.content

    def refuse(self, key: str, allowed: str) -> None:
        """Add the problem that the value of a key is not allowed."""
        self.problems.append(f"{self.where}.{key} is {shown(self.content.get(key))}; it must be {allowed}")

    def refuse_unknown(self, known: Collection[str]) -> None:
        unknown = sorted(shown(key) if not isinstance(key, str) else key[:80] for key in self.content.keys() - known)
        if unknown:
            self.problems.append(
                f"{self.where} has unknown keys {', '.join(unknown[:20])}; known keys are {', '.join(sorted(known))}"
            )

    def section(self, key: str) -> Section | None:
        """The mapping under a key; None, with a problem added, if the key is missing."""
        if key not in self.content:
            self.problems.append(f"{self.where} lacks the key {key}")
            return None
        return Section(self.content[key], f"{self.where}.{key}".removeprefix("config.yaml."), self.problems)

    def integer(self, key: str, most: int, least: int = 1) -> int | None:
        value = self.content.get(key)
        if key not in self.content:
            self.problems.append(f"{self.where} lacks the key {key}, a whole number")
        elif not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            self.refuse(key, f"a whole number from {least} to {most}")
        else:
            return value
        return None

    def boolean(self, key: str, default: bool) -> bool:
        value = self.content.get(key, default)
        if not isinstance(value, bool):
            self.refuse(key, "true or false")
        return value is True

    def choice(self, key: str, allowed: Collection[str | None], default: str | None) -> str | None:
        """One of `allowed`; the default if the key is missing or, with a problem added, if its value is not allowed."""
        value = self.content.get(key, default)
        if (value is None or isinstance(value, str)) and value in allowed:
            return value
        self.refuse(key, f"one of {', '.join('null' if name is None else name for name in allowed)}")
        return default

    def require(self, key: str, expected: object, default: object = None) -> None:
        """Add a problem unless the value is the only one that is supported; `default` applies if the key is missing."""
        if self.content.get(key, default) != expected or type(self.content.get(key, default)) is not type(expected):
            self.refuse(key, f"{shown(expected)}, all that is supported")

    def target(self, allowed: Collection[str]) -> str | None:
        """The class that `_target_` names, by its last component; nothing is imported."""
        value = self.content.get("_target_")
        name = value.rpartition(".")[2] if isinstance(value, str) else ""
        if name in allowed:
            return name
        self.refuse("_target_", f"a name that ends in {' or '.join(allowed)}")
        return None
