"""Reduced bases: snapshots, POD, lifting columns and linear modes."""
