"""Models, loads, and stepping them through time.

(`solid` | `membrane`) > `nodal` > `run` > `loads` > (`contact` | `material`): a room imports only those to its right.

- `material`: compiled stresses: principal stretches, small strain, fibres, viscoelastic history, fields by node
- `contact`: rigid tools, their geometry, contact impulses, held nodes and forceps; the blade and its impulses
- `loads`: one file per load; supports; `prepared.py` lays loads out for a body
- `run`: the contract of a model, `rollout`, trajectories and their files, reactions
- `nodal`: models of nodal displacements: central differences, leapfrog steps of the engine, stability, equilibrium
- `solid`, `membrane`: the models and their strong and energy forms; `solid/cutting`: cut solids
"""
