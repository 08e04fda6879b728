"""`python -m motiongen_server.text.encoder`: read the configuration, serve the encoder."""

from __future__ import annotations

import os
import signal
import sys


def end_at_once(_number: int, _frame: object) -> None:
    """Nothing has begun yet, so nothing has to be ended."""
    os._exit(0)


def main() -> int:
    """0 after an orderly end, 2 for a wrong setting."""
    # The first process of a container is ended by no signal that it does not handle.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end_at_once)
    # Read when grpc is imported. Else each header that gRPC cannot read, and each handshake that is none, is a line of
    # the log.
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")
    import asyncio

    from motiongen_server.ops.logs import configure_logs
    from motiongen_server.settings import SettingError
    from motiongen_server.text.encoder.app import run
    from motiongen_server.text.encoder.config import ENCODER

    try:
        config = ENCODER.parse(sys.argv[1:])
    except SettingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    configure_logs(config.log_level, config.log_format)
    return asyncio.run(run(config))


if __name__ == "__main__":
    sys.exit(main())
