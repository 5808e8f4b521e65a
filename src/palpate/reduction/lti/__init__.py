"""Linear models: a body linearised, its projections, and the bridge to pyMOR."""
