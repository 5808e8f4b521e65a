"""Stability of a strain energy: free of stress at rest, finite, and strongly elliptic.

Strong ellipticity excludes imaginary speeds of small-amplitude waves in a deformed body: the
acoustic tensor

    Q_ik(N) = sum over J, L of  dP_iJ / dF_kL  N_J N_L

is positive definite in every direction N (Truesdell and Noll, The Non-Linear Field Theories of
Mechanics, 1965, section 44). An incompressible body has transverse waves only: Q is restricted to
vectors m with m . F^-T N = 0, where neither the pressure nor a function of J contributes. For an
isotropic law, principal stretches and directions N in one octant suffice. Without ellipticity,
simulations are unstable, with growth rates that increase as the spacing decreases.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, brief, number_in_range
from palpate.tissue.homogeneous import DEFORMATION_KINDS, compressible, deformation_gradient, rest
from palpate.tissue.materials import Material

MIN_STRETCH, MAX_STRETCH = 0.002, 25.0  # widest range; paths through it are checked point by point
DIFFERENCE_STEP = 1e-5  # of F, for central differences of stress
ZERO_MODULUS = 1e-6  # over the shear modulus; smaller moduli are rounding errors
PATH_STEP = 0.01  # stretch between points along the path of a test
GRID_POINTS = 11  # stretches along each side of the grid
OCTANT_DIVISIONS = 10  # of each side of the octant
EDGE_DIRECTIONS = 46  # in the plane of two axes


@dataclass(frozen=True)
class MaterialStability(Described):
    """Result of a stability check of a law.

    Attributes
    ----------
    stable : bool
        True if the list of findings is empty.
    findings : tuple of str
        Reasons against stability.
    stretches, volumes : (float, float)
        Checked range of the principal stretches and of J.
    shear_modulus, bulk_modulus : float [Pa]
        Moduli at rest by differences of stress; the bulk modulus of an incompressible material is
        infinite.
    min_modulus : float [Pa]
        Smallest eigenvalue of the acoustic tensor in the range; NaN where the law is not finite.
    limits : dict
        For each kind of test, the deformations nearest to rest, below and above it, at which
        ellipticity is lost; None where it is kept up to the end of the range. Shears extend to the
        same principal stretches.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.StVenantKirchhoff(mu=2e3, density=1060, poisson=0.45)
    >>> result = pt.materials.material_stability(law, stretches=(0.5, 1.8))
    >>> result.stable, len(result.findings) > 0
    (False, True)
    """

    stable: bool
    findings: tuple[str, ...]
    stretches: tuple[float, float]
    volumes: tuple[float, float]
    shear_modulus: float
    bulk_modulus: float
    min_modulus: float
    limits: dict[str, tuple[float | None, float | None]]

    def _facts(self) -> list[Fact]:
        return [
            ("status", "stable" if self.stable else "not stable", ""),
            ("stretches", self.stretches, ""),
            ("volume ratios", self.volumes, ""),
            ("least modulus of a wave", self.min_modulus, "Pa"),
            ("shear modulus", self.shear_modulus, "Pa"),
            *(("finding", finding, "") for finding in self.findings),
        ]

    @property
    def text(self) -> str:
        """Status in one line, and one line per finding."""
        where = f"principal stretches {self.stretches[0]:.4g} to {self.stretches[1]:.4g}"
        if self.volumes != (1.0, 1.0):
            where += f", J {self.volumes[0]:.4g} to {self.volumes[1]:.4g}"
        if self.stable:
            least = self.min_modulus / self.shear_modulus
            return f"stable for {where}: smallest wave modulus {least:.3g} of the shear modulus at rest"
        return "\n".join([f"not stable for {where}:", *(f"  {finding}" for finding in self.findings)])

    def require(self) -> None:
        """Raise an error for an unstable law.

        Raises
        ------
        InputError
            The law is unstable; the message lists the findings.
        """
        if not self.stable:
            raise InputError(self.text)


def material_stability(
    material: Material,
    stretches: tuple[float, float] = (0.6, 1.8),
    volumes: tuple[float, float] = (0.8, 1.25),
) -> MaterialStability:
    """Check that a law is free of stress at rest, finite, and strongly elliptic in a range.

    Parameters
    ----------
    material : Material
    stretches : (float, float)
        Range of the principal stretches, around 1.
    volumes : (float, float)
        Range of J = det F, around 1; ignored for an incompressible material.

    Returns
    -------
    MaterialStability

    Raises
    ------
    InputError
        A range does not contain 1, or exceeds [0.002, 25].

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.NeoHookean(C1=1.1e3, density=1060, poisson=0.45)
    >>> pt.materials.material_stability(law).stable
    True
    """
    for name, both in (("stretches", stretches), ("volumes", volumes)):
        if not isinstance(both, Sequence | np.ndarray) or len(both) != 2:
            raise InputError(f"{name} must be two numbers, got {brief(both)}")
        number_in_range(f"the lower end of {name}", both[0], MIN_STRETCH, 1.0)
        number_in_range(f"the upper end of {name}", both[1], 1.0, MAX_STRETCH)
    if material.incompressible:
        volumes = (1.0, 1.0)
    with np.errstate(all="ignore"):
        shear, bulk, findings = _check_rest(material)
        scale = abs(shear) if np.isfinite(shear) and shear else 1.0
        F = _grid(stretches, volumes)
        findings += _check_finite(material, F)
        moduli = min_wave_modulus(material, F)
        least = float(np.min(moduli))
        limits = {
            kind: _ellipticity_limits(material, kind, stretches, ZERO_MODULUS * scale) for kind in DEFORMATION_KINDS
        }
    at = int(np.argmin(moduli))
    if least <= ZERO_MODULUS * scale:
        worst = ", ".join(f"{s:.3g}" for s in np.diagonal(F[at]))
        findings.append(f"not elliptic, worst at principal stretches {worst}: a modulus of {least:.3g} Pa")
    for kind, ends in limits.items():
        first = [f"{end:.4g}" for end in ends if end is not None]
        if first:
            label = "shear" if kind == "shear" else "stretch"
            findings.append(f"{kind}: ellipticity is lost at {label} {' and '.join(first)}")
    return MaterialStability(not findings, tuple(findings), stretches, volumes, shear, bulk, least, limits)


def min_wave_modulus(material: Material, F: Floats) -> Floats:
    """Return the smallest eigenvalue (n,) [Pa] of the acoustic tensor over all directions.

    It is the density times the squared speed of the slowest wave in the reference configuration, and NaN where the law
    is not finite. Deformation gradients `F` (n, 3, 3) have volume 1 if the material is incompressible.
    """
    stretches = np.linalg.svd(F, compute_uv=False)
    principal = stretches[:, :, None] * np.eye(3)
    N = _octant()
    A = _tangent(compressible(material), principal)
    finite = np.all(np.isfinite(A), axis=(1, 2, 3, 4))
    A = np.where(finite[:, None, None, None, None], A, 0.0)
    dyads = (N[:, :, None] * N[:, None, :]).reshape(len(N), 9)
    Q = np.einsum("nap,dp->nda", A.transpose(0, 1, 3, 2, 4).reshape(len(F), 9, 9), dyads, optimize=True)
    Q = Q.reshape(len(F), len(N), 3, 3)
    Q = (Q + np.swapaxes(Q, 2, 3)) / 2
    if material.incompressible:
        m = N / stretches[:, None, :]
        m = m / np.linalg.norm(m, axis=2, keepdims=True)
        across = np.eye(3) - m[..., :, None] * m[..., None, :]
        out = np.abs(Q).sum(axis=(2, 3))[..., None, None]  # upper bound of the eigenvalues
        Q = across @ Q @ across + out * m[..., :, None] * m[..., None, :]
    finite &= np.all(np.isfinite(Q), axis=(1, 2, 3))
    Q = np.where(finite[:, None, None, None], Q, 0.0)
    least = np.linalg.eigvalsh(Q)[..., 0].min(axis=1)
    return np.where(finite, least, np.nan)


def _tangent(material: Material, F: Floats) -> Floats:
    """Return dP/dF [Pa], (n, i, J, k, L), by central differences."""
    shifts = DIFFERENCE_STEP * np.eye(9).reshape(9, 1, 3, 3)
    change = material.stress(F + shifts) - material.stress(F - shifts)
    return np.moveaxis(change / (2 * DIFFERENCE_STEP), 0, -1).reshape(len(F), 3, 3, 3, 3)


def _octant() -> Floats:
    """Return unit vectors in one octant, densest in the planes of two axes, the usual directions of slow waves."""
    i, j = np.meshgrid(np.arange(OCTANT_DIVISIONS + 1), np.arange(OCTANT_DIVISIONS + 1))
    valid = i + j <= OCTANT_DIVISIONS
    vectors = np.stack([i[valid], j[valid], OCTANT_DIVISIONS - i[valid] - j[valid]], axis=1) / OCTANT_DIVISIONS
    angle = np.linspace(0, np.pi / 2, EDGE_DIRECTIONS)
    edge = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vectors = np.vstack([vectors, edge, np.roll(edge, 1, axis=1), np.roll(edge, 2, axis=1)])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _grid(stretches: tuple[float, float], volumes: tuple[float, float]) -> Floats:
    """Return diagonal F with l1 >= l2 >= l3 and J in the given ranges, (n, 3, 3); rest is the first."""
    side = np.geomspace(*stretches, GRID_POINTS)
    l1, l2, J = (a.ravel() for a in np.meshgrid(side, side, np.unique([*np.geomspace(*volumes, 4), 1.0])))
    l3 = J / (l1 * l2)
    valid = (l1 >= l2) & (l2 >= l3) & (l3 >= stretches[0] * (1 - 1e-9))
    diagonal = np.vstack([np.ones(3), np.stack([l1, l2, l3], axis=1)[valid]])
    return np.asarray(diagonal[:, :, None] * np.eye(3))


def _check_rest(material: Material) -> tuple[float, float, list[str]]:
    """Return shear and bulk modulus at rest [Pa], and findings there."""
    findings, solid, eye = [], compressible(material), np.eye(3)
    A = _tangent(solid, eye[None])[0]
    shear = float(A[0, 1, 0, 1] + A[0, 1, 1, 0]) / 2
    bulk = np.inf if material.incompressible else float(np.einsum("iijj", A)) / 9
    P = solid.stress(eye[None])[0]
    if material.incompressible:
        P = P - np.trace(P) / 3 * eye
    if not np.all(np.isfinite(P)):
        findings.append("the stress at rest must be finite")
    elif np.abs(P).max() > ZERO_MODULUS * abs(shear):
        findings.append(f"the stress at rest must be zero, got {P.flat[np.abs(P).argmax()]:.4g} Pa")
    for name, value in (("shear", shear), ("bulk", bulk)):
        if not value > 0:
            findings.append(f"the {name} modulus at rest must be in (0, inf) Pa, got {value:.4g}")
    return shear, bulk, findings


def _check_finite(material: Material, F: Floats) -> list[str]:
    solid = compressible(material)
    finite = np.isfinite(solid.strain_energy(F)) & np.all(np.isfinite(solid.stress(F)), axis=(1, 2))
    if np.all(finite):
        return []
    first = np.diagonal(F[~finite], axis1=1, axis2=2)
    nearest = first[np.argmin(np.sum(np.log(first) ** 2, axis=1))]
    return [f"not finite, nearest to rest at principal stretches {', '.join(f'{s:.3g}' for s in nearest)}"]


def _ellipticity_limits(
    material: Material, kind: str, stretches: tuple[float, float], threshold: float
) -> tuple[float | None, float | None]:
    """Return the deformations, below and above rest, where the smallest wave modulus reaches a threshold."""
    if kind == "shear":
        stretch = min(stretches[1], 1 / stretches[0])
        ends: Sequence[float] = (stretch - 1 / stretch,)
    else:
        ends = stretches
    limits = [_first_loss(material, kind, end, threshold) for end in ends]
    return (None, limits[0]) if len(limits) == 1 else (limits[0], limits[1])


def _first_loss(material: Material, kind: str, end: float, threshold: float) -> float | None:
    start = rest(kind)
    along = np.linspace(start, end, 2 + int(abs(end - start) / PATH_STEP))
    F = deformation_gradient(material, kind, along)
    along = along[np.all(np.isfinite(F), axis=(1, 2))]
    moduli = min_wave_modulus(material, F[np.all(np.isfinite(F), axis=(1, 2))])
    bad = np.flatnonzero(~(moduli > threshold))
    if not len(bad):
        return None
    k = int(bad[0])
    if k == 0 or not np.isfinite(moduli[k]):
        return float(along[k])
    share = (moduli[k - 1] - threshold) / (moduli[k - 1] - moduli[k])  # linear interpolation
    return float(along[k - 1] + share * (along[k] - along[k - 1]))
