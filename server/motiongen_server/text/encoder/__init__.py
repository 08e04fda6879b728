"""The text encoder as a service of its own, which many servers can share, and its client."""
