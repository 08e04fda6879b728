"""Training of the tokenizer and the denoiser; each is a command: `python -m motiongen_ardy.train.tokenizer`, `.denoiser`."""
