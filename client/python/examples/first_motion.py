"""A minimal example: one character, four seconds, one file. `python first_motion.py [host:port]`"""

import sys

from motiongen_client.blocking import MotionClient
from motiongen_tools.bvh import write_bvh

address = sys.argv[1] if len(sys.argv) > 1 else "localhost:50051"

with MotionClient(address) as client:
    walker = client.open(prompt="a person walks forward")
    for frame in walker.frames(seconds=4):
        x, _, z = frame.root_translation_m
        print(f"{frame.time_s:4.2f} s: the hips are over x = {x:5.2f} m, z = {z:5.2f} m")
    write_bvh("first_motion.bvh", walker.motion())
    print("wrote first_motion.bvh")
