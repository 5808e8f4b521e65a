"""Real-time engine: steps a model at a fixed rate against a moving tool."""
