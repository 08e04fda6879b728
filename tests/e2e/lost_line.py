"""A real service and the Python client, with a connection that can be cut, and records of what each received."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from motiongen_client import (
    LinePolicy,
    MotionClient,
    Session,
    SessionOptions,
)
from motiongen_server.engine.types import ChannelBlock, Event, Playhead, Resume
from motiongen_server.rpc.limits import Limits
from tests.contract.local import LocalServer
from tests.e2e.tcp_proxy import TcpProxy
from tests.server.engine.fakes import FACTS

FACTS_AS_SERVED = replace(
    FACTS,
    fps=100,  # much motion in little time
    rig=replace(
        FACTS.rig,
        blocks=(
            ChannelBlock("root_translation_m", 3),
            ChannelBlock("joint_rotation_quat_wxyz", 4),
            ChannelBlock("foot_contact", 4),
            ChannelBlock("rest", 1),
        ),
    ),
)


LOOKAHEAD = SessionOptions(lookahead_frames=80)


def a_server(**limits: float) -> LocalServer:
    return LocalServer(Limits(**limits), facts=FACTS_AS_SERVED)  # type: ignore[arg-type]


@asynccontextmanager
async def proxied(
    server: LocalServer, policy: LinePolicy | None = None, budget: Callable[[], int | None] = lambda: None
) -> AsyncIterator[tuple[TcpProxy, MotionClient]]:
    policy = policy or LinePolicy()
    async with TcpProxy(server.address, budget) as proxy, MotionClient(proxy.address, policy=policy) as client:
        yield proxy, client


@dataclass
class Received:
    """What one playback received: the last row of each frame that it holds, or has shown."""

    rows: dict[int, np.ndarray] = field(default_factory=dict)
    changed: list[int] = field(default_factory=list)


@dataclass
class Taken:
    """The numbers of the events that the engine received, by session, without playheads and resumes."""

    numbers: dict[object, list[int]] = field(default_factory=lambda: defaultdict(list))

    def watch(self, server: LocalServer, monkeypatch: pytest.MonkeyPatch) -> None:
        submit = server.engine.submit

        def noting(event: Event) -> object:
            if not isinstance(event, Playhead | Resume):
                self.numbers[event.session].append(event.event_seq)
            return submit(event)

        monkeypatch.setattr(server.engine, "submit", noting)


async def played(session: Session, frames: int) -> list[int]:
    """Play so many frames as fast as they come."""
    seen: list[int] = []
    async for frame in session.frames(realtime=False):
        seen.append(frame.index)
        if len(seen) == frames:
            break
    return seen


def check_history(server: LocalServer, *frames: int) -> None:
    """Check that the server's sessions were reopened with histories that end just before these frames of ours."""
    begun = [job for job in server.runner.prepared if job.first_frame == 0 and len(job.history)]
    assert {frame - 1 for frame in frames} <= {int(job.history[-1, 0]) for job in begun}
