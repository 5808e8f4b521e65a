"""Reduced models that take a tool: from a file, from the user's cache, or trained on a few short runs."""
