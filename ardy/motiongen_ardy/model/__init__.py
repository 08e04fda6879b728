"""The model and how it generates: configuration, diffusion, tokenizer, denoiser, windows, rollout."""
