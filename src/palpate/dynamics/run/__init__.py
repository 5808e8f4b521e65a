"""Runs: the interface of a model, time integration, reactions, trajectories and their files."""
