"""The attack suite: a real server process under hostile clients, with good clients that must not notice."""
