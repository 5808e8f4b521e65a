"""Strain energies."""
