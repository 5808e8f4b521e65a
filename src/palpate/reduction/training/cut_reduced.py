"""A cut in a reduced model: columns of the cut, and terms of the nodes whose stencils it changes.

The coordinates of the uncut body span no opening of a cut. `palpate.reduction.basis.cut_columns` adds the main
static responses of the cut to them. In the energy

    E(a) = sum of w_s W_s(F_s) + 1/2 |c|^2 + 1/2 a . H a,      c = Z (J - 1),

the changed nodes have their own volumes as weights, and their own smoothed dilatations as moments. The other points,
their weights and their moments are chosen again, for states of the training with the static response of the cut. All
terms are energies, so the cut model cannot blow up either. The next columns are the residual fields of the trust
number: it rises where the cut opens in ways that the coordinates miss.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
import scipy.sparse as sparse

from palpate.arrays import Floats, Ints
from palpate.dynamics.nodal.energy_model import Fields
from palpate.dynamics.solid.cutting.cut import cut
from palpate.dynamics.solid.model import EnergySolid, Solid, energy_solid
from palpate.faults import CloudError, InputError, brief, integer_in_range
from palpate.reduction.basis.cut_columns import StaticChanges, static_changes
from palpate.reduction.basis.lifting import support_fields
from palpate.reduction.basis.linear_modes import rest_statics
from palpate.reduction.basis.strain_pod import join
from palpate.reduction.hyper.cubature import Cubature, fit_moments
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.hyper.material_point import volume_measure
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.ecsw import choose_integration_points, deformation
from palpate.reduction.training.fit_compliance import rest_compliance
from palpate.reduction.training.residual_fields import (
    RESIDUAL_FIELDS,
    orthogonal_complement,
    scale_residual_fields,
    typical_residual,
)
from palpate.reduction.training.round_compliance import round_compliance

__all__ = ["cut_reduced"]


MAX_NODES = 6000  # of a body whose equations are solved; the compliance under tools has a lower limit
MAX_STATES = 60  # training states with the static response of the cut
CUBATURE_ERROR = 3e-3  # largest relative error of the sampled forces
MODES_PER_PRESSURE = 4
MAX_SECOND_SHARE = 0.3  # of the second-order displacements of training states, over the linear ones
MIN_SIZE = 1e-6  # of a column, over the first


def cut_reduced(model: ReducedModel, body: Solid, triangles: Any, *, columns: int = 10) -> ReducedModel:
    """Return a reduced model of a body that is cut along triangles.

    It has more modes: `columns`, and second-order responses of their main shapes. States of `model` are not states of
    the cut one: give `rollout` their displacements. Its expected errors are unknown, because no run of the cut body is
    compared.

    Parameters
    ----------
    model : ReducedModel
        Of the uncut body. It does not change.
    body : Solid
        The uncut body in the energy form, of at most 6,000 nodes; of 5,000 if tools touch it.
    triangles : (t, 3, 3) array [m]
        Of the complete cut, as for `palpate.cut`.
    columns : int
        Largest number of static responses of the cut; the model has no more of them than coordinates.

    Returns
    -------
    ReducedModel
        With the number of columns and the seconds that they took in its `report`.

    Raises
    ------
    InputError
        The model and the body differ, or the body is cut already, has planes of symmetry or too many nodes.
    CloudError
        `palpate.cut` raises it; or the cut releases nodes, or cuts a piece off.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.003)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (3 * t, 0, 0))
    >>> model = pt.hyper_reduce(block, pt.rollout(block, [pull], duration=0.1, every=0.005), modes=6)
    >>> a, b, c, d = (0.0155, -0.01, 0.0075), (0.0155, 0.04, 0.0075), (0.0155, 0.04, 0.025), (0.0155, -0.01, 0.025)
    >>> opened = pt.cut_reduced(model, block, [(a, b, c), (a, c, d)], columns=4)
    >>> opened.count > model.count
    True
    >>> whole, wound = (pt.rollout(each, [pull], duration=0.1, every=0.1) for each in (model, opened))
    >>> bool(abs(wound.displacements[-1]).max() > 1.3 * abs(whole.displacements[-1]).max())
    True
    """
    begin = perf_counter()
    solid = _checked(model, body)
    integer_in_range("columns", columns, 1)
    cut_body: Any = cut(solid, triangles)
    if len(cut_body.released_nodes):
        raise CloudError(
            f"triangles of the cut must release no nodes of a reduced model, got {len(cut_body.released_nodes)}; "
            "keep the cut a spacing away from the surface and from other cuts"
        )
    if not cut_body.cut_state.touched.any():
        return model
    data, count = model.data, model.count
    states = _spread(data.training_states)
    fields = data.basis_vectors[:count]
    statics = rest_statics(solid, data.prescribed)
    changes = static_changes((solid, cut_body), statics, fields, states, columns + RESIDUAL_FIELDS)
    displacements = _moderate(np.tensordot(states, fields, 1) + changes.linear, changes.quadratic)
    shapes, residual_fields = _shapes(solid, data, changes, columns)
    cut_data = _cut_data(model, cut_body, shapes, residual_fields, displacements)
    result = ReducedModel(cut_data, step=model.step, single=model.single)
    if data.compliance is not None:
        compliance = rest_compliance(cut_body, cut_body, cut_data.basis_vectors[: result.count])
        factor = 1.0 if data.compliance.interior is None else data.compliance.interior.factor
        fitted = {name: getattr(data.compliance, name) for name in ("stiffening", "bonded_scale")}
        compliance = round_compliance(compliance._replace(**fitted).scaled(factor))
        cut_data = replace(cut_data, compliance=compliance)
    residual_scale = typical_residual(result, cut_body, displacements)
    report = {name: value for name, value in data.report.items() if name not in ("held_out", "advice")}
    rule = cut_data.cubature
    report |= {
        "modes": cut_data.modes, "nodes": len(rule.nodes), "pressure_modes": len(rule.pressure),
        "residual_fields": len(residual_fields), "cubature": CUBATURE_ERROR, "cubature_residual": rule.residual,
        "highest_frequency": result.body.highest_frequency(np.zeros(result.count)),
        "cut_columns": cut_data.modes - data.modes, "cut_nodes": int(cut_body.cut_state.touched.sum()),
        "cut_seconds": perf_counter() - begin,
    }  # fmt: skip
    cut_data = replace(cut_data, residual_scale=residual_scale, report=report)
    return ReducedModel(cut_data, step=model.step, single=model.single)


def _checked(model: Any, body: Any) -> EnergySolid:
    """Return the body; raise `InputError` for one that the model does not belong to."""
    if not isinstance(model, ReducedModel):
        raise InputError(f"model must be a ReducedModel, got {brief(model)}; train one with hyper_reduce")
    body = energy_solid(body)
    same = model.cloud.points.shape == body.cloud.points.shape and np.allclose(model.cloud.points, body.cloud.points)
    if not same:
        raise InputError("body must be the one that the model was trained on, got other points; give that body")
    if len(body.cut_surface.triangles):
        raise InputError("body must be uncut, got a cut one; give the uncut body, and all triangles")
    if len(body.cloud) > MAX_NODES:
        raise InputError(
            f"body must have at most {MAX_NODES} nodes for the statics of its cut, got {len(body.cloud)}; "
            "use a larger spacing"
        )
    return body


def _spread(states: Floats) -> Floats:
    """Return some of the training states, evenly spaced."""
    return states[np.unique(np.linspace(0, len(states) - 1, MAX_STATES).astype(int))]


def _moderate(linear: Floats, quadratic: Floats) -> Floats:
    """Return displacements (t, n, 3), with less load where the second-order part would not be small."""
    first, second = (np.abs(each).max(axis=(1, 2)) for each in (linear, quadratic))
    share = np.minimum(1.0, MAX_SECOND_SHARE * first / np.maximum(second, 1e-300))[:, None, None]
    return np.asarray(share * linear + share**2 * quadratic)


def _shapes(body: EnergySolid, data: ReducedData, changes: StaticChanges, columns: int) -> tuple[Floats, Floats]:
    """Return the modes and the columns, orthonormal together, and the residual fields."""
    weights = np.sqrt(body.volumes)[:, None]
    _, sizes, rows = np.linalg.svd((changes.linear * weights).reshape(len(changes.linear), -1), full_matrices=False)
    rows = rows[sizes > MIN_SIZE * sizes[0]]
    parts = rows.reshape(len(rows), -1, 3) / weights
    modes = data.basis_vectors[: data.modes]
    shapes = join(body, modes, body.supported.project(np.concatenate([parts[:columns], changes.columns])))
    return shapes, orthogonal_complement(body, shapes, parts[columns:])


def _cut_data(
    model: ReducedModel, cut_body: Any, shapes: Floats, residual_fields: Floats, displacements: Floats
) -> ReducedData:
    """Return the data of the cut model, with the scale of the uncut one's residual."""
    data = model.data
    lifting = data.basis_vectors[data.modes : model.count]
    tests = support_fields(cut_body, data.prescribed)
    # rounded to single precision as in the file, so that a saved and loaded model is identical
    basis = np.concatenate([shapes, lifting, tests, residual_fields]).astype(np.float32).astype(float)
    modes, count = len(shapes), len(shapes) + len(lifting)
    fields = cut_body.at_points(basis, slice(count, count + len(tests)))
    flat = basis[:count].reshape(count, -1)
    weighted = flat * np.repeat(cut_body.masses, 3)
    mass = weighted @ flat.T
    states = np.linalg.solve(mass, weighted @ displacements.reshape(len(displacements), -1).T).T
    places, rule, moments = _terms(cut_body, fields.of(slice(len(basis) - len(residual_fields))), modes, states, mass)
    sizes = modes, len(residual_fields)
    fields, gradients = scale_residual_fields(cut_body, fields, sizes, states, rule, places, moments)
    return replace(
        data, basis_vectors=fields.columns, modes=modes, cubature=rule, gradients=gradients, constant=fields.constant,
        training_states=states, residual_fields=len(residual_fields), compliance=None,
    )  # fmt: skip


def _terms(cut_body: Any, fields: Fields, modes: int, states: Floats, mass: Floats) -> tuple[Ints, Cubature, Floats]:
    """Return the places of the integration points, the cubature, and the moments (k, n) of all dilatations.

    The changed nodes have their own volumes as weights.
    """
    count, changed, smooth = len(mass), cut_body.cut_state.touched, _smoothing(cut_body)
    roots = np.sqrt(cut_body.tissue.lame * cut_body.bulk_volumes)
    gradients, others = fields.gradients[:, :count], np.flatnonzero(~changed)
    dilatation = [volume_measure(cut_body.material, deformation(gradients, state)[2] - 1)[0] for state in states]
    theta = np.array([smooth @ each for each in dilatation]) * roots
    sizes = np.linalg.norm(theta, axis=1)
    theta /= np.sqrt(np.maximum(sizes, 1e-3 * sizes.max()))[:, None]
    shapes = np.linalg.svd(theta, full_matrices=False)[2][: max(1, modes // MODES_PER_PRESSURE)]
    moments = np.asarray((shapes * roots) @ smooth)
    rest = Fields(
        fields.columns, fields.gradients[others], fields.constant, fields.nodes[others], fields.volumes[others]
    )
    _, rule = choose_integration_points(cut_body, rest, modes, states, mass, CUBATURE_ERROR, moments[:, others], 0)
    weights = np.where(changed, fields.volumes, 0.0)
    weights[rule.nodes] = rule.weights
    places = np.flatnonzero(weights > 0)
    pressure = _fit_moments(cut_body, gradients, states, moments, places)
    return places, Cubature(places, weights[places], pressure, rule.residual), moments


def _smoothing(body: Any) -> Any:
    """Return the matrix of the smoothing, sparse (n, n)."""
    near, weights, diagonal = body.smoothing
    n = len(near)
    rows = np.repeat(np.arange(n), near.shape[1])
    return (sparse.csr_array((weights.ravel(), (rows, near.ravel())), (n, n)) + sparse.diags_array(diagonal)).tocsr()


def _fit_moments(cut_body: Any, gradients: Floats, states: Floats, moments: Floats, places: Ints) -> Floats:
    """Return coefficients (k, s) with which the points' dilatations have the moments and slopes of all nodes."""
    sampled, summed = [], []
    for state in (np.zeros(states.shape[1]), *states):
        _, cofactor, J = deformation(gradients, state)
        value, rise = volume_measure(cut_body.material, J - 1)
        flux = (cofactor * rise[:, None, None]).reshape(-1, 9, 1).astype(gradients.dtype)
        slope = np.matmul(gradients, flux)[..., 0].astype(float)
        rows = np.column_stack([slope, value / max(float(np.linalg.norm(state)), 1e-300) * bool(state.any())])
        sampled.append(rows[places])
        summed.append(moments @ rows)
    return fit_moments(np.hstack(sampled), np.hstack(summed))
