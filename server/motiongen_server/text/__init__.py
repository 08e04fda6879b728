"""Prompts to vectors: the encoder and its cache, presets, and the encoder as a service."""
