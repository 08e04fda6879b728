"""A real server process that tells a collector of every window, from the edit to the frame that the client gets."""

from __future__ import annotations

from pathlib import Path

import psutil

from motiongen_client import MotionClient
from tests.scale.replicas import NULL_SERVER, Replica
from tests.server.ops.collector import Collector, attributes
from tests.waiting import until, until_true


async def test_an_edit_is_traced_from_its_arrival_to_its_frames(tmp_path: Path) -> None:
    with Collector() as collector:
        server = Replica("server", tmp_path, "none", ["--trace-to", f"grpc:127.0.0.1:{collector.port}"], NULL_SERVER)
        server.begin()
        try:
            until(lambda: server.is_ready)
            async with MotionClient(f"127.0.0.1:{server.behind.port}") as client:
                session = await client.open("a person walks")
                await until_true(lambda: session.playback.received_to > 0)  # else the first window answers it too
                outcome = await session.set_velocity(0.0, 1.4)
                await until_true(lambda: session.playback.received_to > (outcome.effective_frame or 0))
                await session.close()
            assert server.process is not None
            engines = {each.pid for each in psutil.Process(server.process.pid).children(recursive=True)}
        finally:
            server.stop()  # which sends what has not been sent yet
        told = [(span, attributes(span)) for span in collector.spans]
        (edit,) = [span for span, said in told if said["motiongen.cause"] == "EDIT" and said["motiongen.num_events"]]
        said = attributes(edit)
        assert said["motiongen.engine"] in {f"pid {pid}" for pid in engines}
        assert said["motiongen.sent"]
        assert said["motiongen.first_frame"] <= (outcome.effective_frame or 0)
        moments = [edit.start_time_unix_nano, *(event.time_unix_nano for event in edit.events), edit.end_time_unix_nano]
        assert moments == sorted(moments)
        assert len({said["motiongen.session"] for _, said in told}) == 1
        plans = [said["motiongen.plan"] for _, said in told]
        assert plans == sorted(set(plans)), "each plan once"
