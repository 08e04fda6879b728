"""Several servers behind real proxies, with a real Redis: started, killed, and observed by characters that play."""
