"""``palpate cache``: the compiled functions that a user keeps."""
