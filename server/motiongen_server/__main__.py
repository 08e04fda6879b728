"""`python -m motiongen_server`: reads the configuration and runs the application."""

from __future__ import annotations

import os
import signal
import sys

SIGNALS = (signal.SIGTERM, signal.SIGINT)


def end_at_once(_number: int, _frame: object) -> None:
    """End the process: nothing has been started yet that would have to be stopped."""
    os._exit(0)


def main() -> int:
    """The exit code: 0 after an orderly end, 2 for an invalid setting, 1 if startup or the engines failed."""
    for number in SIGNALS:
        signal.signal(number, end_at_once)
    # Without this, every header that gRPC cannot read and every failed handshake is logged.
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")
    # Imported only now, because that takes a second: a signal in that time must end the process as well.
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
