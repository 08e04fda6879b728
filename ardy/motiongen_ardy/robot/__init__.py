"""Robots: motion <-> joint angles, what a controller needs beside them, and sessions that start from measured state."""
