"""Several servers behind real proxies, with a real Redis: started, killed, and watched by characters."""
