"""``palpate check``: whether a surface can be filled, and how good its cloud is."""
