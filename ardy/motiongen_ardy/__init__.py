"""ARDY: autoregressive diffusion over a hybrid of explicit root and latent body tokens.

The model library of motiongen, usable alone: skeletons, features, tokenizer, denoiser, rollout, checkpoints,
training and evaluation. Right-handed, +Y up, +Z forward, metres, seconds, radians.
"""
