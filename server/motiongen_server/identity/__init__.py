"""Who a caller is, by which credentials, and what it may do: TLS, tokens, tenants."""
