"""The content of YAML, of which JSON is a part; unlike PyYAML, refuses names that are given twice."""

from __future__ import annotations

from typing import TYPE_CHECKING

from motiongen_client.errors import MissingExtra

if TYPE_CHECKING:
    from yaml import Node

_MOST_QUOTED = 60


def parse_yaml(content: bytes) -> object:
    """The content. Raises MissingExtra, and ValueError for what is no YAML, or has a name twice in a mapping."""
    try:
        import yaml
    except ImportError:
        raise MissingExtra("reading a scenario", "pyyaml", "bench") from None
    try:
        loader = yaml.SafeLoader(content)
        try:
            root = loader.get_single_node()
            fault = "" if root is None else _repeated_name(root)  # before merged names are put beside a mapping's own
            document: object = None if root is None else loader.construct_document(root)
        finally:
            loader.dispose()
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a number with thousands of digits
        raise ValueError(f"not YAML or JSON: {' '.join(str(error).split())}") from None
    if fault:
        raise ValueError(fault)
    return document


def _repeated_name(root: Node) -> str:
    """What to say of a name that is twice in a mapping, where the first value would be ignored; "" if there is none."""
    from yaml import MappingNode, ScalarNode, SequenceNode

    pending, seen = [root], set()
    while pending:
        node = pending.pop()
        if id(node) in seen:  # repeated by an alias
            continue
        seen.add(id(node))
        if isinstance(node, SequenceNode):
            pending += node.value
        elif isinstance(node, MappingNode):
            names: set[str] = set()
            for name, value in node.value:
                if isinstance(name, ScalarNode) and name.value in names:
                    line = name.start_mark.line + 1
                    return f"line {line} gives {name.value[:_MOST_QUOTED]!r} again"
                if isinstance(name, ScalarNode):
                    names.add(name.value)
                pending += (name, value)
    return ""
