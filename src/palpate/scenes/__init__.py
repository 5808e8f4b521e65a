"""Scenes: bodies with their loads, one file each."""
