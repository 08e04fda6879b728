"""Many characters on one stream, drawn by one loop as in a game. `python crowd.py [host:port] [characters]`"""

import asyncio
import sys

from motiongen_client import MotionClient, Priority, SessionOptions, StartPose

PROMPTS = ("a person walks forward", "a person runs forward", "a person waves with the right hand")


async def main(address: str, num_characters: int) -> None:
    async with MotionClient(address) as client, client.stream() as stream:
        opening = []
        for number in range(num_characters):
            start = StartPose(x_m=1.5 * (number % 10), z_m=-1.5 * (number // 10))
            options = SessionOptions(seed=number, priority=Priority.CROWD, start=start)
            opening.append(stream.open(PROMPTS[number % len(PROMPTS)], options=options))
        crowd = await asyncio.gather(*opening)
        for _ in range(4 * 60):  # four seconds at sixty pictures a second
            poses = [character.poll() for character in crowd]  # draw these; None before the first frame
            await asyncio.sleep(1 / 60)
        shown = sum(pose is not None for pose in poses)
        underruns = sum(character.stats.underruns for character in crowd)
        print(f"{shown} of {num_characters} characters on screen, {underruns} frames held in all")


asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "localhost:50051", int(sys.argv[2]) if len(sys.argv) > 2 else 8))
