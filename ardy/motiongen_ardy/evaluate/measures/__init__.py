"""Figures of motion in metres, seconds, radians, from world joint positions."""
