"""`python -m motiongen_server`: read the configuration, run the application."""

from __future__ import annotations

import os
import signal
import sys

SIGNALS = (signal.SIGTERM, signal.SIGINT)


def end_at_once(_number: int, _frame: object) -> None:
    """Nothing has begun yet, so nothing has to be ended."""
    os._exit(0)


def main() -> int:
    """0 after an orderly end, 2 for a wrong setting, 1 when start-up or the engine failed."""
    for number in SIGNALS:
        signal.signal(number, end_at_once)
    # Else each header that gRPC cannot read, and each handshake that is none, adds a line to the log.
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")
    # Only now, because they take a second: who is asked to stop meanwhile ends as at any other time.
    import asyncio

    from motiongen_server.config import parse_config
    from motiongen_server.ops.logs import configure_logs
    from motiongen_server.ops.memory import keep_freed_memory
    from motiongen_server.run import leave, run
    from motiongen_server.settings import SettingError

    try:
        config = parse_config(sys.argv[1:])
    except SettingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    configure_logs(config.log_level, config.log_format)
    keep_freed_memory()
    leave(asyncio.run(run(config)))


if __name__ == "__main__":
    sys.exit(main())
