"""What every command shares: words of the command line, reports, figures, drawing off-screen, files for ParaView."""
