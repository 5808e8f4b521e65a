"""Solids: the strong form and the energy form."""
