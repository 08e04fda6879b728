"""Figures of motion in metres, seconds and radians, from world joint positions."""
