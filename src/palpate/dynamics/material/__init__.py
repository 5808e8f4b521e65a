"""Compiled stresses: principal stretches, fibres, viscoelastic history and material fields."""
