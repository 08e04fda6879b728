"""Training of tokenizer and denoiser, each a command: `python -m motiongen_ardy.train.tokenizer`, `.denoiser`."""
