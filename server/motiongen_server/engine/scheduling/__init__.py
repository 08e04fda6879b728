"""Whose window is computed next, on which share of the device, and who is let in."""
