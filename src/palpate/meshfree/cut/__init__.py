"""Cuts in clouds: their surfaces, the stencils near them, and weights that keep sums."""
