"""Who calls, by which credentials, and what they may: TLS, tokens, tenants."""
