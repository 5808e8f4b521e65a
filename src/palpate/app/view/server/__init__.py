"""HTTP and WebSocket server of `palpate view`."""
