"""Command line, figures, files."""
