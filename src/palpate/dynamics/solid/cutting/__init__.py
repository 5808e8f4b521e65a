"""Cuts of solids by blades: cut bodies, the incision, its front and its faces."""
