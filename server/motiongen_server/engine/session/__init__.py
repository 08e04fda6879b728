"""One character: its motion so far, what steers it, and its next window."""
