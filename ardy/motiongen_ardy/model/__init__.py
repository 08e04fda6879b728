"""The model and its generation of motion: configuration, diffusion, tokenizer, denoiser, windows, rollout."""
