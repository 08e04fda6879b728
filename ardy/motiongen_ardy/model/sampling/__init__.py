"""Sampling apart from the networks: a model's own options, planned roots, and corrections of finished windows."""
