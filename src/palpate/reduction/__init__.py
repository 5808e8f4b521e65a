"""Proper orthogonal decomposition, and models of few coordinates.

(`training` | `storage`) > `hyper` > (`contact` | `galerkin` | `lti`) > `basis`: a room imports only those to its right.

- `basis`: snapshots, POD, incremental POD, POD of strains, lifting, linear modes
- `galerkin`: the paper's projected model and its step
- `contact`: compliance of a surface: coarser bodies, residual flexibility, near field; projected Gauss-Seidel
- `lti`: the linearised body, its projections, the bridge to pyMOR
- `hyper`: sampled energy, explicit and implicit steps, the reduced body, its reactions and error bound
- `training`: `hyper_reduce`: energy-conserving sampling and weighting, fits of compliance and bound
- `storage`: model files, and the body in them
"""
