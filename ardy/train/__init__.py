"""Training of the tokenizer and the denoiser; each is a command: `python -m ardy.train.tokenizer`, `.denoiser`."""
