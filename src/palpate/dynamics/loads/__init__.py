"""Loads, foundations, and loads prepared for a body."""
