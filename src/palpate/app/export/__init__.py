"""``palpate export``: a model as a library for programs without Python."""
