"""Models of nodal displacements, central differences and stability."""
