"""The attack suite: a real server process under hostile clients, beside neighbours that must not notice."""
