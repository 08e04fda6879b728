"""The command `motiongen` and what it is made of: demo, clips, file tools, pictures, load generator."""
