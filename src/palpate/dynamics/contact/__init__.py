"""Rigid tools, their geometry and contact impulses."""
