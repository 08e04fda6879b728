"""Robots: motion <-> joint angles, trajectories for controllers, and sessions that start from measured state."""
