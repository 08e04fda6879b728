"""Generate `python/motiongen/v1` from the protos: `python proto/generate.py [--out FOLDER]`.

Needs grpcio-tools, whose protoc is pinned by `constraints.txt`, so that every machine writes the same bytes.
"""

from __future__ import annotations

import argparse
import re
import sys
from importlib.resources import files
from pathlib import Path

from grpc_tools import protoc

ROOM = Path(__file__).resolve().parent
PACKAGE = Path("motiongen/v1")


def generate(out: Path) -> list[Path]:
    """Write messages, type stubs and gRPC stubs below `out`; return the files written, sorted."""
    sources = sorted(path.relative_to(ROOM).as_posix() for path in (ROOM / PACKAGE).glob("*.proto"))
    well_known = str(files("grpc_tools") / "_proto")
    out.mkdir(parents=True, exist_ok=True)
    common = ["protoc", f"--proto_path={ROOM}", f"--proto_path={well_known}"]
    run([*common, f"--python_out={out}", f"--pyi_out={out}", *sources])
    run([*common, f"--grpc_python_out={out}", "motiongen/v1/service.proto"])
    written = sorted((out / PACKAGE).glob("*_pb2*"))
    for path in written:
        path.write_text(tidy(path.read_text(encoding="utf-8")), encoding="utf-8", newline="\n")
    return written


def run(arguments: list[str]) -> None:
    """Run protoc in this process. Raises RuntimeError when it refuses a file; protoc has printed which and why."""
    if protoc.main(arguments) != 0:
        raise RuntimeError(f"protoc refused the protos; it was given {arguments[1:]}")


def tidy(text: str) -> str:
    """One newline at the end and no space before any: what the repository's hooks want of every text file."""
    return re.sub(r"[ \t]+\n", "\n", text).rstrip("\n") + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOM / "python", help="folder to write below (default: %(default)s)")
    for path in generate(parser.parse_args().out):
        print(path.name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
