"""A body in real time behind a page: the session that owns the engine, its recordings, and the server."""
