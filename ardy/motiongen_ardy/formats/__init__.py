"""Files: motion, constraints and paths, as this and other tools write them. Untrusted, bounded, never a pickle."""
