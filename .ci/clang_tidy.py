"""Run clang-tidy over what client/cpp ships; files that passed are skipped until they or their includes change.

    python .ci/clang_tidy.py BUILD_FOLDER CLANG_TIDY

BUILD_FOLDER: where CMake has written compile_commands.json. Files that passed are recorded there, by a hash of the
file, its includes and the command.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "client" / "cpp"
LOOKED_AT = ("src", "load", "examples")
INCLUDE = re.compile(rb'^#include "([^"]+)"', re.MULTILINE)


class Checker:
    """Checks files, and records those that passed. tidy: the clang-tidy program."""

    def __init__(self, folder: Path, tidy: str) -> None:
        self._tidy = tidy
        self._folder = folder
        self._passed = folder / "tidied"
        self._passed.mkdir(exist_ok=True)
        version = subprocess.run([tidy, "--version"], stdout=subprocess.PIPE, check=True).stdout
        self._rules = version + (SOURCE / ".clang-tidy").read_bytes()

    def check(self, entry: dict[str, str]) -> str:
        """Check a file of compile_commands.json. Returns clang-tidy's findings, or nothing if there are none."""
        path = Path(entry["file"])
        mark = self._passed / self._key(path, entry["command"])
        if mark.exists():
            return ""
        command = [self._tidy, "-p", str(self._folder), "--quiet", str(path)]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode == 0:
            mark.touch()
            return ""
        told = re.sub(r"^\d+ warnings? generated\.\n", "", done.stdout, flags=re.MULTILINE)  # third-party headers
        return f"{path.relative_to(SOURCE)}:\n{told}"

    def _key(self, path: Path, command: str) -> str:
        """The hash of a file, of everything of ours that it includes, of the rules and of the command."""
        words = shlex.split(command)
        folders = [Path(word[2:]) for word in words if word.startswith("-I")]
        folders += [Path(word) for flag, word in itertools.pairwise(words) if flag == "-isystem"]
        seen: set[Path] = set()
        waiting, digest = [path], hashlib.sha256(self._rules + command.encode())
        while waiting:
            file = waiting.pop()
            if file in seen:
                continue
            seen.add(file)
            content = file.read_bytes()
            digest.update(content)
            for name in sorted(INCLUDE.findall(content)):
                found = [each / name.decode() for each in (file.parent, *folders) if (each / name.decode()).is_file()]
                waiting += found[:1]
        return digest.hexdigest()


def main(folder: str, tidy: str) -> int:
    checker = Checker(Path(folder), tidy)
    entries = json.loads((Path(folder) / "compile_commands.json").read_text(encoding="utf-8"))
    ours = [entry for entry in entries if Path(entry["file"]).is_relative_to(SOURCE)]
    ours = [entry for entry in ours if Path(entry["file"]).relative_to(SOURCE).parts[0] in LOOKED_AT]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as workers:
        wrong = [told for told in workers.map(checker.check, ours) if told]
    print(*wrong, f"{len(ours)} files checked, {len(wrong)} with findings", sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
