"""Compiled code: vector lanes, the cache of kernels, and passes over nodes."""
