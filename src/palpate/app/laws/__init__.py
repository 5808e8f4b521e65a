"""``palpate laws``: the material laws with their parameters."""
