"""``palpate reproduce``: the examples of the paper with full and reduced models, and the paper's claims."""
