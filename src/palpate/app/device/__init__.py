"""Haptic devices that move the tools of a session; see docs/howto/haply.md."""
