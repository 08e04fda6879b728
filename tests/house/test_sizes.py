"""A file has at most 300 lines, and a function at most six positional arguments."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

MOST_LINES = 300
MOST_POSITIONAL = 6
CODE = {".c", ".cmake", ".cpp", ".cs", ".css", ".h", ".hpp", ".html", ".js", ".py", ".sh"}
"""Without protos, which are mostly comments and become one module each."""
GENERATED = Path("proto/python")


def code_files(repository: Any) -> list[Path]:
    return [path for path in repository.files if path.suffix in CODE and GENERATED not in path.parents]


def many_positional(source: str) -> list[str]:
    """Names of the functions with too many positional arguments, not counting self and cls.

    Kernels are left out: Triton has no keyword-only arguments.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not is_kernel(node):
            names = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args)]
            if len([name for name in names if name not in ("self", "cls")]) > MOST_POSITIONAL:
                found.append(node.name)
    return found


def is_kernel(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any(ast.unparse(decorator).startswith("triton.jit") for decorator in node.decorator_list)


def test_files_are_short(repository: Any) -> None:
    files = code_files(repository)
    lengths = {path: len((repository.root / path).read_text(encoding="utf-8").splitlines()) for path in files}
    long = [f"{path}: {length} lines" for path, length in lengths.items() if length > MOST_LINES]
    assert long == [], "two subjects are two files"
    assert len(files) > 1000


def test_functions_have_few_positional_arguments(repository: Any) -> None:
    files = [path for path in code_files(repository) if path.suffix == ".py"]
    sources = {path: (repository.root / path).read_text(encoding="utf-8") for path in files}
    found = [f"{path}: {name}" for path, source in sources.items() for name in many_positional(source)]
    assert found == [], "a dataclass is missing, or a * after which arguments are named"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("def f(a, b, c, d, e, f): ...", []),
        ("def f(a, b, c, /, d, e, f, g): ...", ["f"]),
        ("def f(a, *, b, c, d, e, f, g): ...", []),
        ("@triton.jit\ndef f(a, b, c, d, e, f, g): ...", []),
        ("class A:\n    async def m(self, a, b, c, d, e, f): ...", []),
        ("class A:\n    def m(self, a, b, c, d, e, f, g): ...", ["m"]),
    ],
)
def test_positional_arguments_are_counted(source: str, found: list[str]) -> None:
    assert many_positional(source) == found
