"""Compiled functions of palpate, read by `palpate.shipped_code`; this package holds data only."""
