"""Linear models: a body linearised, its linear reductions, and what they cost."""
