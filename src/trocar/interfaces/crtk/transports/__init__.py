"""How messages travel: each file or folder an adapter of the core, and a stranger to the next."""
