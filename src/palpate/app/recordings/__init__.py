"""Recordings of sessions: their files, and the tool paths in them."""
