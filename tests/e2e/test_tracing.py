"""A real server process that sends a trace of every window to a collector."""

from __future__ import annotations

from pathlib import Path

from motiongen_client import MotionClient
from tests.attack.server import attacked
from tests.server.ops.collector import Collector, attributes
from tests.waiting import until_true


async def test_an_edit_is_traced_from_its_arrival_to_its_frames(tmp_path: Path) -> None:
    with Collector() as collector:
        settings = ("--trace-to", f"grpc:127.0.0.1:{collector.port}", "--admit-load", "1000", "--degrade", "false")
        with attacked(tmp_path / "log", settings) as server:  # ending it sends the spans that are left
            async with MotionClient(server.address) as client:
                session = await client.open("a person walks")
                await until_true(
                    lambda: session.playback.received_to > 0
                )  # otherwise the first window would include the edit
                outcome = await session.set_velocity(0.0, 1.4)
                await until_true(lambda: session.playback.received_to > (outcome.effective_frame or 0))
                await session.close()
            engines = {each.pid for each in server.engines()}
        assert server.exit_code == 0
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
        assert plans == sorted(set(plans)), "each plan is traced once"
