"""Files of motion, constraints and paths, of this and other tools. They are untrusted: bounded, and never pickles."""
