"""Loads, foundations, and prepared loads."""
