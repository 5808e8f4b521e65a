"""Solids in the strong form and in the energy form."""
