"""Decides whose window is computed next, how engines share a device, and which sessions are admitted."""
