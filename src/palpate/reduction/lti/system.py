"""Linearisation of a body: M u'' + D u' + K u = B f with chosen inputs and outputs.

The unknowns are the displacements of the free nodes, in the model's ordering: component c of node i
is number 3 i + c of the body, and `LinearSystem.dofs` are the numbers of the unknowns. A node that slides on
a support has unknowns along its free directions (`LinearSystem.directions`). Rows are
multiplied by the nodes' weights in the inner product (`NodalModel.weights`). So M is the lumped
mass, a diagonal, and B holds the shares of the nodes in the total forces. D = alpha M + beta K is the
damping of (29).

K of the energy form is symmetric. That of the strong form is collocated: row i is the balance of
momentum at node i, and not the work on a shape function, so K is not symmetric. With the weights it
is nearly symmetric; it is not symmetrised.

The input of a tool that moves nodes is its damped acceleration g'' + alpha g', with the tool's
coordinates g. L is the static continuation of the rigid motions of the tool's nodes: K L = 0 at all
free nodes. Displacements are u = w + L g, and

    M w'' + D w' + K w = B f - M L (g'' + alpha g'),

because K L = 0. The outputs y = Cp w + Cv w' + Df [f, g'' + alpha g'] + S g + S' g' have a part
that follows the tool without delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from palpate.core.arrays import Complex, Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError
from palpate.dynamics.contact.tools import Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import Load, PreparedLoads, check_kinds, listed
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.supports import constrained_directions, free_directions
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.model import State
from palpate.reduction.lti.stiffness import nodal_stiffness

AXES = "xyz"
INPUT_LOADS = (DeadLoad, Gravity, PrescribedMotion, Grasp)  # kinds of loads that are inputs
MIN_ROTATION = 1e-9  # displacement, in spacings, below which a rotation is left out


@dataclass(frozen=True)
class LinearSystem(Described):
    """Linear system of a body at a state, with the displacements of its free nodes as unknowns.

    Parameters
    ----------
    model : NodalModel
    loads : tuple of loads
        Loads of the inputs; their values in time are not used.
    at : (n, 3) array [m]
        Displacements of the state.
    dofs : (d,) int array
        Numbers 3 i + c of the unknowns; c counts the free directions of a node that slides on a support.
    directions : sparse (3 n, d) array
        Displacement fields of the unknowns, orthonormal.
    mass, stiffness : sparse (d, d) arrays [kg], [N/m]
        The mass is diagonal.
    input : sparse (d, p) array
        Nodal forces of a unit of every input: a total force of 1 N, a gravity of 1 m/s^2, then a
        tool's damped acceleration of 1 m/s^2 or 1 rad/s^2.
    output : sparse (q, d) array
        Cp, in compressed rows.
    feedthrough : (q, p) array
        Df.
    inputs, outputs : tuples of str
        Their names, such as ``"force x on x+"`` and ``"displacement z of x+"``.
    lifting : (l, n, 3) array
        Static fields L of the tools' coordinates: translations [m/m], then rotations [m/rad]; the
        last l inputs are their damped accelerations.
    static : (q, l) array
        S.
    whole : sparse (3 n, 3 n) array [N/m]
        Stiffness of all nodes, including those that are not free.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> system.order, system.symmetric
    (288, True)
    >>> system.transfer(0.0).shape
    (1, 3, 3)
    """

    model: NodalModel
    loads: tuple[Load, ...]
    at: Floats
    dofs: NDArray[np.int64]
    directions: Any
    mass: Any
    stiffness: Any
    input: Any
    output: Any
    feedthrough: Floats
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    lifting: Floats
    static: Floats
    whole: Any = field(repr=False)

    def _facts(self) -> list[Fact]:
        return [
            ("unknowns", self.order, ""),
            ("nodes", len(self.model.cloud), ""),
            ("symmetric", self.symmetric, ""),
            ("at rest", not self.at.any(), ""),
            ("inputs", self.inputs, ""),
            ("outputs", self.outputs, ""),
            ("stiffness damping", float(self.model.stiffness_damping), "s"),
            ("mass damping", float(self.model.mass_damping) or None, "1/s"),
        ]

    @property
    def order(self) -> int:
        """Number of unknowns d."""
        return len(self.dofs)

    @property
    def symmetric(self) -> bool:
        """Whether the stiffness is symmetric: that of the energy form."""
        return self.model.conservative

    @cached_property
    def damping(self) -> Any:
        """Damping D = alpha M + beta K, sparse (d, d) [N s/m]."""
        damping = self.model.stiffness_damping * self.stiffness
        if self.model.mass_damping:
            damping = damping + self.model.mass_damping * self.mass
        return damping.tocsc()

    @cached_property
    def rate_output(self) -> Any:
        """Cv, sparse (q, d): stiffness damping of the forces in Cp."""
        rates = self.output.copy()
        rates.data *= np.repeat(self._force_damping, np.diff(rates.indptr))
        rates.eliminate_zeros()
        return rates

    @cached_property
    def static_rate(self) -> Floats:
        """S' (q, l): stiffness damping of the forces in S."""
        damping = self._force_damping[:, None]
        return np.where(damping > 0, damping * self.static, 0.0)

    @property
    def _force_damping(self) -> Floats:
        """Stiffness damping (q,) [s] of the outputs that are forces; 0 of displacements."""
        forces = [name.startswith("force ") for name in self.outputs]
        return np.where(forces, self.model.stiffness_damping, 0.0)

    @property
    def forces(self) -> int:
        """Number of inputs other than those of tools."""
        return len(self.inputs) - len(self.lifting)

    @property
    def lifts(self) -> Floats:
        """The tools' static fields by degree of freedom, (l, 3 n)."""
        return self.lifting.reshape(len(self.lifting), 3 * len(self.model.cloud))

    def fields(self, columns: Any) -> Floats:
        """Return nodal fields (k, n, 3) of unknowns (d, k), zero at nodes that are not free."""
        result = np.ascontiguousarray((self.directions @ np.asarray(columns)).T)
        return result.reshape(len(result), -1, 3)

    def pencil(self, s: complex) -> Any:
        """Return s^2 M + s D + K, sparse (d, d)."""
        return (s * s * self.mass + s * self.damping + self.stiffness).tocsc()

    def transfer(self, points: Any) -> Complex:
        """Return the transfer function from inputs to outputs at complex frequencies s (k,) [1/s], shape (k, q, p).

        For tools it is that from their damped accelerations g'' + alpha g', without the static part S g + S' g'.
        """
        result = []
        for s in np.atleast_1d(np.asarray(points, dtype=complex)):
            solved = splu(self.pencil(s)).solve(self.input.toarray().astype(complex))
            result.append((self.output + s * self.rate_output) @ solved + self.feedthrough)
        return np.array(result)

    def frequency_response(self, frequencies: Any) -> Complex:
        """Return the transfer function at circular frequencies (k,) [rad/s], shape (k, q, p)."""
        return self.transfer(1j * np.atleast_1d(np.asarray(frequencies, dtype=float)))

    def scales(self, emphasis: Sequence[float] | Floats | None = None) -> tuple[Floats, Floats]:
        """Return factors (q,) of the outputs and (p,) of the inputs that make different units comparable.

        Displacements and forces are each divided by their largest static response to the weighted
        inputs, and a tool's rotations by its radius. `to_pymor` and `from_pymor` take the factors.

        Parameters
        ----------
        emphasis : (p,) array, optional
            Weight of each input; by default equal.
        """
        count = len(self.inputs)
        weights = np.ones(count) if emphasis is None else np.array(emphasis, dtype=float)
        if weights.shape != (count,) or not np.all(np.isfinite(weights) & (weights > 0)):
            raise InputError(f"emphasis must be {count} positive numbers, one per input, got {emphasis!r}")
        static = np.abs(self.transfer(0.0)[0].real) * weights
        kinds = np.array([name.split()[0] for name in self.outputs])
        outputs, inputs = np.ones(len(kinds)), np.ones(count)
        for kind in np.unique(kinds):
            outputs[kinds == kind] = 1.0 / max(static[kinds == kind].max(), 1e-300)
        if len(self.lifting):
            inputs[self.forces :] = 1.0 / np.abs(self.lifting).max(axis=(1, 2))
        return outputs, inputs * weights


def linearise(
    model: NodalModel,
    loads: Load | Sequence[Load] = (),
    outputs: Sequence[str] = (),
    state: State | Floats | None = None,
) -> LinearSystem:
    """Linearise a body about a state.

    Parameters
    ----------
    model : NodalModel
        `Solid` or `Membrane`.
    loads : load or sequence of loads
        The inputs. A `SurfaceForce` has three for its force, along the axes, and three for its
        moment; `Gravity` has three. A tool that moves nodes (`PrescribedMotion`, `Grasp`) has six:
        three translations, and three rotations about the mean position of its nodes. Their values in
        time are not part of the system.
    outputs : sequence of str
        Groups of nodes: the mean displacement of a free group, or the total force of a support on
        the body. The forces of tools, one per coordinate, are always the last outputs.
    state : State or (n, 3) array, optional [m]
        State of linearisation; rest by default.

    Returns
    -------
    LinearSystem

    Raises
    ------
    InputError
        A load that is not an input of a linear system, an unknown group, tools on a body in its
        strong form, or a viscoelastic material.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> system.inputs
    ('force x on x+', 'force y on x+', 'force z on x+')
    >>> system.outputs
    ('displacement x of x+', 'displacement y of x+', 'displacement z of x+')
    """
    if not isinstance(model, NodalModel):
        raise InputError(f"model must be a Solid or a Membrane, got a {type(model).__name__}")
    if model.material.prony is not None:
        raise InputError("material must be without prony, which M, D and K do not describe; leave prony out")
    loads = listed(loads)
    check_kinds(loads, INPUT_LOADS, "loads of a linear system", "leave it out, or run the nonlinear body")
    _check_moved_nodes(loads, model)
    displaced = state.coordinates if isinstance(state, State) else state
    at = np.zeros((len(model.cloud), 3)) if displaced is None else np.array(displaced, dtype=float)
    if at.shape != (len(model.cloud), 3) or not np.isfinite(at).all():
        raise InputError(f"state must be finite displacements of shape {(len(model.cloud), 3)}, got shape {at.shape}")
    prepared = model.prepare(loads)
    nodal = nodal_stiffness(model, at if at.any() else None)
    free, dofs = free_directions(model.supported, prepared.sites.prescribed)
    weight = np.repeat(model.weights * model.material.density, 3)
    stiffness = (free.T @ nodal @ free).tocsc()
    rigid, tools = _rigid_motions(model, prepared)
    lifting = _continued(nodal, free, stiffness, rigid)
    forces, names = force_inputs(model, prepared, weight)
    pushed = np.concatenate([forces @ free, -(weight * lifting) @ free]).T
    mass, kind = sparse.diags(weight[dofs]).tocsc(), "damped acceleration" if model.mass_damping else "acceleration"
    return LinearSystem(
        model, loads, at, dofs, free, mass, stiffness,
        sparse.csc_matrix(pushed), *_outputs(model, prepared, outputs, nodal, free, (forces, rigid, lifting), weight),
        (*names, *(f"{kind} of {tool}" for tool in tools)), _output_names(model, outputs, tools),
        lifting.reshape(len(lifting), len(model.cloud), 3),
        _statics(model, prepared, outputs, nodal, (rigid, lifting)), nodal,
    )  # fmt: skip


def _check_moved_nodes(loads: Sequence[Load], model: NodalModel) -> None:
    """Refuse tools that move nodes of a body in its strong form."""
    for load in loads:
        if isinstance(load, PrescribedMotion | Grasp) and not model.conservative:
            raise InputError(
                "loads must not move nodes of a linearised body in its strong form, "
                f"got a {type(load).__name__}; give the body form='energy' (docs/howto/linear.md)"
            )


def _rigid_motions(model: NodalModel, prepared: PreparedLoads) -> tuple[Floats, list[str]]:
    """Return unit translations and rotations of the tools' nodes (l, 3 n), and their names."""
    points, columns, names = model.cloud.points, [], []
    for motion, where in prepared.motions:
        nodes = prepared.sites.prescribed[where]
        arms = np.pad(points[nodes] - points[nodes].mean(axis=0), ((0, 0), (0, 3 - points.shape[1])))
        for kind in ("translation", "rotation"):
            for c in range(3):
                shifts = (
                    np.broadcast_to(np.eye(3)[c], arms.shape) if kind == "translation" else np.cross(np.eye(3)[c], arms)
                )
                if np.abs(shifts).max() <= MIN_ROTATION * model.cloud.spacing:
                    continue
                column = np.zeros((len(points), 3))
                column[nodes] = shifts
                columns.append(column.ravel())
                names.append(f"{motion.group}, {kind} {AXES[c]}")
    return np.array(columns).reshape(-1, 3 * len(points)), names


def _continued(nodal: Any, free: Any, stiffness: Any, rigid: Floats) -> Floats:
    """Return the static continuation (l, 3 n) of the tools' motions, without forces at free nodes."""
    fields = rigid.copy()
    if len(rigid):
        try:
            fields -= (free @ splu(stiffness).solve(free.T @ (nodal @ rigid.T))).T
        except RuntimeError as error:
            raise InputError("stiffness of the body at this state must be non-singular; fix a group") from error
    return fields


def force_inputs(model: NodalModel, prepared: PreparedLoads, weight: Floats) -> tuple[Floats, list[str]]:
    """Return nodal forces (p, 3 n) of unit amplitudes and accelerations, and their names, in the order of the loads."""
    sites, n, columns, names, g = prepared.sites, len(model.cloud), [], [], 0
    for load in prepared.loads:
        if isinstance(load, Gravity):
            columns += [weight * np.tile(np.eye(3)[c], n) for c in range(3)]
            names += [f"gravity {AXES[c]}" for c in range(3)]
        elif isinstance(load, DeadLoad):
            dead = slice(sites.dead_start[g], sites.dead_start[g + 1])
            for a in range(len(load.labels)):
                column = np.zeros((n, 3))
                np.add.at(column, sites.dead_node[dead], sites.dead_pattern[dead, a])
                columns.append(column.ravel())
            names += [f"{label} on {load.group}" for label in load.labels]
            g += 1
    return np.array(columns).reshape(-1, 3 * n), names


def _output_names(model: NodalModel, outputs: Sequence[str], tools: Sequence[str]) -> tuple[str, ...]:
    names = []
    for group in outputs:
        what = "force {} of {}" if group in model.fixed else "displacement {} of {}"
        names += [what.format(axis, group) for axis in AXES]
    return (*names, *(f"force of {tool}" for tool in tools))


def _rows(model: NodalModel, prepared: PreparedLoads, group: str) -> Any:
    """Return the map (3, 3 n) from displacements to their mean over a group."""
    nodes = prepared.supports[group] if group in prepared.supports else model.cloud.group(group)
    n = len(model.cloud)
    places = np.repeat(np.arange(3), len(nodes)), np.concatenate([3 * nodes + c for c in range(3)])
    return sparse.csr_matrix((np.full(3 * len(nodes), 1.0 / len(nodes)), places), (3, 3 * n))


def _outputs(
    model: NodalModel, prepared: PreparedLoads, outputs: Sequence[str], nodal: Any, free: Any,
    inputs: tuple[Floats, Floats, Floats], weight: Floats,
) -> tuple[Any, Floats]:  # fmt: skip
    """Return Cp (q, d) and Df (q, p)."""
    forces, rigid, lifting = inputs
    positions, through = [], []
    for group in outputs:
        if group not in model.fixed:
            positions.append(_rows(model, prepared, group) @ free)
            through.append(np.zeros((3, len(forces) + len(lifting))))
            continue
        map_to_force, direct = _support_force(model, group, nodal, free, forces, bool(len(rigid)))
        positions.append(map_to_force)
        through.append(np.hstack([direct, np.zeros((3, len(lifting)))]))
    if len(rigid):
        positions.append(sparse.csr_matrix(rigid) @ nodal @ free)
        # a tool carries the loads on its nodes, and accelerates their mass
        through.append(np.hstack([-rigid @ forces.T, (rigid * weight) @ rigid.T]))
    if not positions:
        raise InputError("outputs must name a group for a system without a tool, got none; name a group")
    return sparse.vstack(positions).tocsr(), np.concatenate(through)


def _support_force(
    model: NodalModel, group: str, nodal: Any, free: Any, forces: Floats, tools: bool
) -> tuple[Any, Floats]:
    """Return the maps from displacements (3, d) and inputs (3, forces) to the total force of a support on the body."""
    n = len(model.cloud)
    total = sparse.csr_matrix(np.tile(np.eye(3), n))
    if model.conservative:
        nodes = (3 * model.cloud.group(group)[:, None] + np.arange(3)).ravel()
        loads = sparse.csr_matrix(_constrained_part(model, group)) @ total[:, nodes] @ forces.T[nodes]
        return _force_rows(model, group, nodal) @ free, -loads
    if len(model.fixed) > 1 or tools:
        raise InputError(
            f"support {group!r} must be the only one, without tools, for its force to be an output of the strong form; "
            "use form='energy'"
        )
    # balance of momentum of the whole body: the collocated rows weighted by volumes, not by `weights`
    along = sparse.csr_matrix(_constrained_part(model, group))
    rows = along @ total @ sparse.diags(np.repeat(model.volumes / model.weights, 3)) @ free
    return -(rows @ (free.T @ nodal @ free)), np.asarray(rows @ (free.T @ forces.T) - along @ total @ forces.T)


def _force_rows(model: NodalModel, group: str, nodal: Any) -> Any:
    """Return the map (3, 3 n) from displacements to the force of a support, in the energy form.

    The internal forces along the normal of a plane of symmetry include those of the images, which the
    support exerts (`NodalModel.without_images`).
    """
    nodes = (3 * model.cloud.group(group)[:, None] + np.arange(3)).ravel()
    total = sparse.csr_matrix(np.tile(np.eye(3), len(model.cloud)))
    rows = total[:, nodes] @ nodal.tocsr()[nodes]
    if any(plane.name == group for plane in model.planes):
        rows = rows - total @ nodal
    return sparse.csr_matrix(_constrained_part(model, group)) @ rows


def _constrained_part(model: NodalModel, group: str) -> Floats:
    """Return the projection (3, 3) of a force on the directions that a support constrains."""
    axes = constrained_directions(model.cloud, model.supports).get(group, np.eye(3))
    return np.asarray(axes.T @ axes)


def _statics(
    model: NodalModel, prepared: PreparedLoads, outputs: Sequence[str], nodal: Any, tools: tuple[Floats, Floats]
) -> Floats:
    """Return S (q, l), the static part of the outputs in the tools' coordinates."""
    rigid, lifting = tools
    statics = []
    for group in outputs:
        fixed = group in model.fixed
        rows = _force_rows(model, group, nodal) if fixed else _rows(model, prepared, group)
        statics.append(np.asarray(rows @ lifting.T))
    if len(rigid):
        statics.append(np.asarray(rigid @ (nodal @ lifting.T)))
    return np.concatenate(statics)
