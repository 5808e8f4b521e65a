"""Export of real-time models to libraries without Python: lowering, memory layout, and code for each target."""
