"""Compiled stresses of laws and fibres, history variables and material fields."""
