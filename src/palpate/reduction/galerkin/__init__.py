"""Galerkin projection of the equations of motion at every node."""
