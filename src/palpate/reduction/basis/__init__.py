"""Reduced bases: snapshots, POD, lifting functions and linear modes."""
