"""Finite-element reference values for a clamped hyperelastic block.

The block has a square cross section and its long axis along x; the face x = 0 is fully
clamped.  Two kinds of values are written to ``reference/finite_elements.json``:

* the static displacement under a dead traction, uniform over the end face;
* the lowest circular frequencies of small vibrations about the unloaded state.

The elements are 27-node hexahedra of FElupe with 3 x 3 x 3 integration points.  For the
sideways forces and the frequencies, the volumetric term lam/2 (J - 1)^2 is integrated
with 2 x 2 x 2 points, which avoids volumetric locking.  This reduced rule has unstable
modes at the large stretches of the axial forces, where the full rule is used instead;
these stretches converge fast with it.  Symmetry planes halve or quarter the block.  The
meshes are finer at the clamped face and the outer edges, where stresses concentrate.
All quantities are in SI units (m, kg, s, N, Pa).
"""

import json
from pathlib import Path

import numpy as np
from block_model import WIDTH, Block
from mooney_rivlin import check_material
from scipy.sparse.linalg import LinearOperator, eigsh, splu

DENSITY = 1120.0
AXIAL_FORCES = (10.0, 50.0, 100.0)
SIDEWAYS_FORCES = (0.02, 0.05, 0.1)
FREQUENCY_POISSON_RATIOS = (0.3, 0.45, 0.49, 0.499)
MESHES = (2, 4, 6)  # elements over the half width, from coarse to fine
FREQUENCY_LENGTHS = (0.1, 0.2)
SUBSTEPS = 4  # load steps from each force to the next
# Displacement components fixed on the planes y = 0 and z = 0 for each kind of vibration.
VIBRATIONS = {
    "bending": ([1], [0, 1]),
    "torsion": ([0, 2], [0, 1]),
    "axial": ([1], [2]),
}
OUTPUT = Path(__file__).parent / "reference" / "finite_elements.json"
ABOUT = (
    "SI units. Clamped block, 0.02 m square section, 1120 kg/m^3, compressible "
    "Mooney-Rivlin W = C1/2 (I1-3) + C2/2 (I2-3) - (C1+2 C2) ln J + lam/2 (J-1)^2, "
    "C1 = 60e3 Pa, C2 = 1.2e3 Pa, lam from the Poisson ratio at small strain. Static "
    "values: length 0.2 m, dead uniform traction of total 'force' on the end face "
    "along x (axial) or z (sideways); 'mean_tip' is the area average and 'centre_tip' "
    "the value at the centre of the end-face displacement in m. Frequencies: first "
    "bending (pair), torsion and axial, in rad/s. 'mesh_change' is the largest "
    "difference between the last two meshes (in m for static values, relative for "
    "frequencies); 'elements_across' gives their elements over the full width."
)


def factorise(matrix):
    """Return the sparse LU factors of a symmetric matrix."""
    return splu(
        matrix,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def equilibrium(block, u, forces, free, tolerance=1e-8, iterations=15):
    """Solve for the displacement under dead nodal forces with Newton's method.

    Parameters
    ----------
    block : Block
        The model.
    u : ndarray, shape (n, 3)
        Start of the iteration [m].
    forces : ndarray, shape (n, 3)
        Nodal forces [N].
    free : ndarray of int
        Free degrees of freedom.
    tolerance : float
        Allowed norm of the residual relative to that of the forces.
    iterations : int
        Largest number of iterations.

    Returns
    -------
    ndarray, shape (n, 3)
        Displacement [m].
    """
    u = u.copy()
    scale, lu = np.linalg.norm(forces), None
    for _ in range(iterations):
        residual = (forces.ravel() - block.residual(u))[free]
        if np.linalg.norm(residual) < tolerance * scale:
            if lu is not None and np.any(lu.U.diagonal() <= 0):
                raise RuntimeError("the equilibrium is unstable")
            return u
        lu = factorise(block.stiffness()[free][:, free])
        step = np.zeros(u.size)
        step[free] = lu.solve(residual)
        u = _backtrack(block, u, step.reshape(-1, 3), forces)
    raise RuntimeError("Newton's method did not converge")


def _backtrack(block, u, step, forces):
    """Return u plus the largest of step, step/2, step/4... which lowers the energy."""
    start = block.energy(u) - np.sum(forces * u)
    for halvings in range(6):
        trial = u + 0.5**halvings * step
        change = block.energy(trial) - np.sum(forces * trial) - start
        if change < 1e-10 * abs(start):  # false for nan, where an element is inverted
            return trial
    raise RuntimeError("no step of Newton's method lowers the energy")


def load_to(block, u, forces, unit, free, halvings=4):
    """Return the equilibrium at forces[1] [N] from u at forces[0], in parts if needed.

    ``unit`` holds the nodal forces of a total force of 1 N; the step is halved
    ``halvings`` times at most.
    """
    start, end = forces
    try:
        return equilibrium(block, u, end * unit, free)
    except RuntimeError:
        if not halvings:
            raise
    middle = (start + end) / 2
    u = load_to(block, u, (start, middle), unit, free, halvings - 1)
    return load_to(block, u, (middle, end), unit, free, halvings - 1)


def static_values(poisson, forces, direction):
    """Return the tip displacements of the 0.2 m block under end forces.

    Parameters
    ----------
    poisson : float
        Poisson ratio.
    forces : sequence of float
        Increasing total forces on the whole end face [N].
    direction : int
        Axis of the force: 0 along the block, 2 sideways.

    Returns
    -------
    list of dict
        Entries of the reference file, one per force.
    """
    axial = direction == 0
    coarser, states, tips = None, {}, {force: [] for force in forces}
    for cells in MESHES:
        block = Block(0.2, poisson, cells, quarter=axial, reduced=not axial)
        free = block.free([1], [2] if axial else [])
        # block.end_weights covers the modelled part of the end face
        unit = np.zeros((block.mesh.npoints, 3))
        unit[:, direction] = block.end_weights / WIDTH**2
        u, previous = np.zeros_like(unit), 0.0
        for force in forces:
            steps = np.linspace(previous, force, SUBSTEPS + 1)[1:]
            if coarser is not None and not axial:
                u, steps = coarser.refined(block, states[force]), [force]
            for step in steps:
                u = load_to(block, u, (previous, step), unit, free)
                previous = step
            states[force] = u
            tips[force].append(block.tip(u))
            print(poisson, cells, force, *tips[force][-1], flush=True)
        coarser = block
    return [_static_entry(poisson, force, tips[force]) for force in forces]


def _static_entry(poisson, force, tips):
    """Return one static entry of the reference file from the tips on all meshes."""
    mean, centre = tips[-1]
    change = max(abs(new - old).max() for new, old in zip(*tips[-2:], strict=True))
    return {
        "poisson": poisson,
        "force": force,
        "mean_tip": mean.tolist(),
        "centre_tip": centre.tolist(),
        "mesh_change": float(change),
        "elements_across": [2 * cells for cells in MESHES[-2:]],
    }


def lowest_vibration(block, kind):
    """Return the lowest frequency of one kind and its share of the axial mass.

    Parameters
    ----------
    block : Block
        A quarter model.
    kind : str
        Key of `VIBRATIONS`.

    Returns
    -------
    float
        Circular frequency [rad/s].
    float
        Effective mass of the mode along x over the mass of the block, 0 to 1.
    """
    free = block.free(*VIBRATIONS[kind])
    block.residual(np.zeros((block.mesh.npoints, 3)))
    stiffness = block.stiffness()[free][:, free]
    full_mass = block.bodies[0].assemble.mass(DENSITY).tocsc()
    mass = full_mass[free][:, free]
    lu = factorise(stiffness)
    inverse = LinearOperator(stiffness.shape, lu.solve, dtype=float)
    squares, modes = eigsh(stiffness, 3, mass, sigma=0.0, OPinv=inverse)
    mode = np.zeros(full_mass.shape[0])
    mode[free] = modes[:, 0]
    along = np.zeros_like(mode)
    along[::3] = 1.0
    participation = (along @ full_mass @ mode) ** 2 / (along @ full_mass @ along)
    return float(np.sqrt(squares[0])), float(participation)


def frequencies(length, poisson):
    """Return the frequency entry of the reference file for a length [m] and ratio."""
    found = []
    for cells in MESHES:
        block = Block(length, poisson, cells, quarter=True, reduced=True)
        pairs = {kind: lowest_vibration(block, kind) for kind in VIBRATIONS}
        print(length, poisson, cells, pairs, flush=True)
        if pairs["axial"][1] < 0.5:
            raise RuntimeError("the first doubly symmetric mode is not axial")
        found.append({kind: pair[0] for kind, pair in pairs.items()})
    changes = [abs(found[-1][kind] / found[-2][kind] - 1) for kind in VIBRATIONS]
    return {
        "length": length,
        "poisson": poisson,
        **found[-1],
        "mesh_change": max(changes),
        "elements_across": [2 * cells for cells in MESHES[-2:]],
    }


def main():
    """Compute all values and write them after each group."""
    check_material()
    result = {"axial": [], "sideways": [], "frequencies": [], "about": ABOUT}
    OUTPUT.parent.mkdir(exist_ok=True)

    def save():
        OUTPUT.write_text(json.dumps(result, indent=1) + "\n")

    def add_static(poisson):
        result["axial"] += static_values(poisson, AXIAL_FORCES, 0)
        save()
        result["sideways"] += static_values(poisson, SIDEWAYS_FORCES, 2)
        save()

    add_static(0.45)
    for length in FREQUENCY_LENGTHS:
        for poisson in FREQUENCY_POISSON_RATIOS:
            result["frequencies"].append(frequencies(length, poisson))
            save()
    add_static(0.49)
    add_static(0.3)


if __name__ == "__main__":
    main()
