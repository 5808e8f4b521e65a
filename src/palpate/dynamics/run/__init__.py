"""Runs: the contract of a model, trajectories and their files, rollout and reactions."""
