"""A minimal example: four seconds of one character, written to a file. `python first_motion.py [host:port]`"""

import sys

import numpy as np

from motiongen_client.blocking import MotionClient

address = sys.argv[1] if len(sys.argv) > 1 else "localhost:50051"

with MotionClient(address) as client:
    walker = client.open(prompt="a person walks forward")
    for frame in walker.frames(seconds=4):
        x, _, z = frame.root_translation_m
        print(f"{frame.time_s:4.2f} s: the hips are over x = {x:5.2f} m, z = {z:5.2f} m")
    motion = walker.motion()
    np.savez(
        "first_motion.npz",
        joint_names=walker.rig.joint_names,
        joint_positions_m=motion.joint_positions_m(),
        joint_rotation_quat_wxyz=motion.joint_rotation_quat_wxyz,
    )
    print("wrote first_motion.npz; `motiongen stream` writes BVH too")
