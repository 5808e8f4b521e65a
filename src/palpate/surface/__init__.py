"""Closed triangulated surfaces: readers of files, faults and repair, remeshing and isosurfaces."""
