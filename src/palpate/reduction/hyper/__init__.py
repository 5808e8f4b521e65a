"""The hyper-reduced model: sampled energy, steps, loads and error indicator."""
