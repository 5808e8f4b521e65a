"""``palpate check``: faults of a surface, and the quality of its cloud."""
