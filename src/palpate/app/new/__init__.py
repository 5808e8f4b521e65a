"""Command ``palpate new``: a scene file for a surface."""
