"""The text encoder as a service of its own, and its client: many servers share one large encoder."""
