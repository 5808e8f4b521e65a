"""Clouds of points, and moving least squares on them."""
