"""Sessions without a server: engine and tool, recordings, replays, and scripts."""
