"""Proper orthogonal decomposition, and models of few coordinates."""
