"""Models, loads, and stepping them through time."""
