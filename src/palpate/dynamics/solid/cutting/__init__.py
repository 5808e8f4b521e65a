"""Cuts of solids by blades: cut bodies, the cut front and its faces."""
