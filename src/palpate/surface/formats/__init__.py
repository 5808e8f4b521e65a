"""Readers of surface files: each takes the bytes of a file and returns its parts."""
