"""Training campaigns: many runs along random paths, and a reduced model of all of them."""
