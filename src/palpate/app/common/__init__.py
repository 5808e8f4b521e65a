"""Shared parts of all commands: command line, reports, figures, off-screen drawing, files for ParaView."""
