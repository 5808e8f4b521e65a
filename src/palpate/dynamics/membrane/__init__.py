"""Membranes: passes, moduli and additional stress."""
