"""Which models there are: their engines made, held, loaded and unloaded."""
