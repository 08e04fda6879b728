"""Sampling beside the networks: a model's own defaults, planned roots, and what is corrected after a window."""
