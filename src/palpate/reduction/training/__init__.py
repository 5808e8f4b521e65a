"""Training of hyper-reduced models, and their errors."""
