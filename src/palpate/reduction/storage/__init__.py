"""Files of reduced models."""
