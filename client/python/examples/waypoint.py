"""Ask a character to be at a place at a time, and measure the error. `python waypoint.py [host:port]`"""

import asyncio
import math
import sys

from motiongen_client import MotionClient


async def main(address: str) -> None:
    async with MotionClient(address) as client:
        walker = await client.open(prompt="a person walks forward")
        frame = walker.frame_in(3.0)
        await walker.add_waypoint(0.5, 3.0, frame=frame)  # raises EventRefused if the server refuses it
        async for _ in walker.frames(seconds=4, realtime=False):  # as fast as they are generated
            pass
        x, _, z = walker.motion().frame(frame).root_translation_m
        print(f"asked for x = 0.50 m, z = 3.00 m at frame {frame}; came to x = {x:.2f} m, z = {z:.2f} m")
        print(f"missed by {100 * math.hypot(x - 0.5, z - 3.0):.0f} cm")


asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "localhost:50051"))
