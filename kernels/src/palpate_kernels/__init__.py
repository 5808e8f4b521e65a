"""Compiled functions of palpate, read by `palpate.compiled.shipped_code`; this package holds data only."""
