"""Hyper-reduced models at a fixed rate."""
