"""Change a character's prompt during playback, and see when the change shows. `python change_prompt.py [host:port]`"""

import asyncio
import sys

from motiongen_client import MotionClient


async def main(address: str) -> None:
    async with MotionClient(address) as client:
        person = await client.open(prompt="a person walks forward")
        async for _ in person.frames(seconds=2):
            pass
        print(f"frame {person.playback.playhead} is shown; now: a person waves with the right hand")
        edit = person.set_prompt("a person waves with the right hand")
        async for _ in person.frames(seconds=2):
            pass
        outcome = await edit
        print(f"the change shows from frame {outcome.effective_frame}; frames before it did not change")
        if edit.latency_s is not None:
            print(f"its first frame arrived {1000 * edit.latency_s:.0f} ms after the call")


asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "localhost:50051"))
