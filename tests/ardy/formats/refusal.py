"""What every reader must do with every file: read or refuse it."""

from __future__ import annotations

import warnings
from pathlib import Path

from motiongen_ardy.formats.errors import FormatError
from tests.ardy.formats.mutations import Reader

LONGEST_MESSAGE = 1_500


def read_or_refuse(reader: Reader, path: Path, content: bytes) -> bool:
    """Whether the file is read; a FormatError is a refusal. Other exceptions, and warnings, pass to the caller."""
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            reader.read(path)
        except FormatError as error:
            message = str(error)
            assert len(message) - len(str(path)) < LONGEST_MESSAGE, f"a message of {len(message)} characters"
            return False
    return True
