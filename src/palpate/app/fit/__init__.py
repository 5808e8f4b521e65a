"""A law from measured curves."""
