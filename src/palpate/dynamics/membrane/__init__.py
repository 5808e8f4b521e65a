"""Membranes: the model, its passes, moduli and additional stress."""
