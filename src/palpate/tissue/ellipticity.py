"""Whether a strain energy is fit to be computed with: at rest without stress, finite, and strongly elliptic.

Strong ellipticity says that no wave of small motions on a deformed body has an imaginary speed: the acoustic tensor

    Q_ik(N) = sum over J, L of  dP_iJ / dF_kL  N_J N_L

is positive definite in every direction N (Truesdell and Noll, The Non-Linear Field Theories of Mechanics, 1965,
section 44). A body that keeps its volume only has waves across the deformed normal: Q counts on vectors m with
m . F^-T N = 0, on which neither the pressure nor a function of J has a part. An isotropic law needs to be looked at in
principal stretches and directions N of one octant only. Without ellipticity a simulation tears itself apart, the
faster the finer the spacing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.faults import InputError, brief, number_in_range
from palpate.tissue.homogeneous import KINDS, compressible, deformation_gradient, rest
from palpate.tissue.materials import Material

__all__ = ["MaterialStability", "least_wave_modulus", "material_stability"]


LEAST, MOST = 0.002, 25.0  # ends of the widest range; the path through it is looked at point by point
STEP = 1e-5  # of the differences of stress
NOTHING = 1e-6  # in shear moduli: moduli below are rounding noise, or none
PATH = 0.01  # between points along the path of a test
SIDE = 11  # stretches along a side of the grid
DIRECTIONS = 10  # along a side of the octant
EDGE = 46  # directions between two axes


@dataclass(frozen=True)
class MaterialStability(Described):
    """Where a law is sound.

    Attributes
    ----------
    stable : bool
        Nothing was found against it.
    findings : tuple of str
        What was found against it.
    stretches, volumes : (float, float)
        Range of the principal stretches and of J that was looked at.
    shear_modulus, bulk_modulus : float [Pa]
        At rest, measured by differences of stress; the bulk modulus of an incompressible material is infinite.
    least_modulus : float [Pa]
        Least eigenvalue of the acoustic tensor in the range; NaN where the law is not finite.
    lost : dict
        For each kind of test the deformations nearest to rest, below and above it, at which ellipticity is lost on
        the way to the ends of the range; None where it is not. Shears reach as far as their principal stretches.
    """

    stable: bool
    findings: tuple[str, ...]
    stretches: tuple[float, float]
    volumes: tuple[float, float]
    shear_modulus: float
    bulk_modulus: float
    least_modulus: float
    lost: dict[str, tuple[float | None, float | None]]

    def _facts(self) -> list[Fact]:
        return [
            ("verdict", "stable" if self.stable else "not stable", ""),
            ("stretches", self.stretches, ""),
            ("volume ratios", self.volumes, ""),
            ("least modulus of a wave", self.least_modulus, "Pa"),
            ("shear modulus", self.shear_modulus, "Pa"),
            *(("finding", finding, "") for finding in self.findings),
        ]

    @property
    def text(self) -> str:
        """The verdict in one line, and a line for each finding."""
        where = f"principal stretches {self.stretches[0]:.4g} to {self.stretches[1]:.4g}"
        if self.volumes != (1.0, 1.0):
            where += f", J {self.volumes[0]:.4g} to {self.volumes[1]:.4g}"
        if self.stable:
            least = self.least_modulus / self.shear_modulus
            return f"stable for {where}: least modulus of a wave {least:.3g} of the shear modulus at rest"
        return "\n".join([f"not stable for {where}:", *(f"  {finding}" for finding in self.findings)])

    def require(self) -> None:
        """Refuse an unstable law.

        Raises
        ------
        InputError
            Names everything found against it.
        """
        if not self.stable:
            raise InputError(self.text)


def material_stability(
    material: Material,
    stretches: tuple[float, float] = (0.6, 1.8),
    volumes: tuple[float, float] = (0.8, 1.25),
) -> MaterialStability:
    """Check that a law is without stress at rest, finite, and strongly elliptic in a range.

    Parameters
    ----------
    material : Material
    stretches : (float, float)
        Range of the principal stretches, around 1.
    volumes : (float, float)
        Range of J = det F, around 1; without meaning for an incompressible material.

    Returns
    -------
    MaterialStability

    Raises
    ------
    InputError
        A range that does not hold 1, or reaches below 0.002 or beyond 25.
    """
    for name, both in (("stretches", stretches), ("volumes", volumes)):
        if not isinstance(both, Sequence | np.ndarray) or len(both) != 2:
            raise InputError(f"the range of {name} must be two numbers, got {brief(both)}")
        number_in_range(f"the lower end of {name}", both[0], LEAST, 1.0)
        number_in_range(f"the upper end of {name}", both[1], 1.0, MOST)
    if material.incompressible:
        volumes = (1.0, 1.0)
    with np.errstate(all="ignore"):
        shear, bulk, findings = _at_rest(material)
        scale = abs(shear) if np.isfinite(shear) and shear else 1.0
        F = _grid(stretches, volumes)
        findings += _finite(material, F)
        moduli = least_wave_modulus(material, F)
        least = float(np.min(moduli))
        lost = {kind: _lost(material, kind, stretches, NOTHING * scale) for kind in KINDS}
    at = int(np.argmin(moduli))
    if least <= NOTHING * scale:
        worst = ", ".join(f"{s:.3g}" for s in np.diagonal(F[at]))
        findings.append(f"not elliptic, worst at principal stretches {worst}: a modulus of {least:.3g} Pa")
    for kind, ends in lost.items():
        first = [f"{end:.4g}" for end in ends if end is not None]
        if first:
            label = "shear" if kind == "shear" else "stretch"
            findings.append(f"{kind}: ellipticity is lost at {label} {' and '.join(first)}")
    return MaterialStability(not findings, tuple(findings), stretches, volumes, shear, bulk, least, lost)


def least_wave_modulus(material: Material, F: Floats) -> Floats:
    """Return the least eigenvalue of the acoustic tensor over all directions.

    Parameters
    ----------
    material : Material
    F : (n, 3, 3) array
        Deformation gradients; of volume 1 if the material is incompressible.

    Returns
    -------
    (n,) array [Pa]
        Density times the square of the slowest wave's speed, by undeformed length. NaN where the law is not finite.
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
        out = np.abs(Q).sum(axis=(2, 3))[..., None, None]  # no less than any eigenvalue
        Q = across @ Q @ across + out * m[..., :, None] * m[..., None, :]
    finite &= np.all(np.isfinite(Q), axis=(1, 2, 3))
    Q = np.where(finite[:, None, None, None], Q, 0.0)
    least = np.linalg.eigvalsh(Q)[..., 0].min(axis=1)
    return np.where(finite, least, np.nan)


def _tangent(material: Material, F: Floats) -> Floats:
    """Return dP/dF [Pa], (n, i, J, k, L), by central differences."""
    shifts = STEP * np.eye(9).reshape(9, 1, 3, 3)
    change = material.stress(F + shifts) - material.stress(F - shifts)
    return np.moveaxis(change / (2 * STEP), 0, -1).reshape(len(F), 3, 3, 3, 3)


def _octant() -> Floats:
    """Unit vectors all over one octant, densest in the planes of two axes, where the slowest waves often travel."""
    i, j = np.meshgrid(np.arange(DIRECTIONS + 1), np.arange(DIRECTIONS + 1))
    kept = i + j <= DIRECTIONS
    vectors = np.stack([i[kept], j[kept], DIRECTIONS - i[kept] - j[kept]], axis=1) / DIRECTIONS
    angle = np.linspace(0, np.pi / 2, EDGE)
    edge = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vectors = np.vstack([vectors, edge, np.roll(edge, 1, axis=1), np.roll(edge, 2, axis=1)])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _grid(stretches: tuple[float, float], volumes: tuple[float, float]) -> Floats:
    """Return diagonal F with l1 >= l2 >= l3 and J in the given ranges, (n, 3, 3); rest is the first."""
    side = np.geomspace(*stretches, SIDE)
    l1, l2, J = (a.ravel() for a in np.meshgrid(side, side, np.unique([*np.geomspace(*volumes, 4), 1.0])))
    l3 = J / (l1 * l2)
    kept = (l1 >= l2) & (l2 >= l3) & (l3 >= stretches[0] * (1 - 1e-9))
    diagonal = np.vstack([np.ones(3), np.stack([l1, l2, l3], axis=1)[kept]])
    return np.asarray(diagonal[:, :, None] * np.eye(3))


def _at_rest(material: Material) -> tuple[float, float, list[str]]:
    """Shear and bulk modulus at rest [Pa], and what is wrong there."""
    findings, twin, eye = [], compressible(material), np.eye(3)
    A = _tangent(twin, eye[None])[0]
    shear = float(A[0, 1, 0, 1] + A[0, 1, 1, 0]) / 2
    bulk = np.inf if material.incompressible else float(np.einsum("iijj", A)) / 9
    P = twin.stress(eye[None])[0]
    if material.incompressible:
        P = P - np.trace(P) / 3 * eye
    if not np.all(np.isfinite(P)):
        findings.append("at rest the stress is not finite")
    elif np.abs(P).max() > NOTHING * abs(shear):
        findings.append(f"at rest there is a stress of {P.flat[np.abs(P).argmax()]:.4g} Pa")
    for name, value in (("shear", shear), ("bulk", bulk)):
        if not value > 0:
            findings.append(f"at rest the {name} modulus is {value:.4g} Pa: allowed is (0, inf)")
    return shear, bulk, findings


def _finite(material: Material, F: Floats) -> list[str]:
    twin = compressible(material)
    whole = np.isfinite(twin.strain_energy(F)) & np.all(np.isfinite(twin.stress(F)), axis=(1, 2))
    if np.all(whole):
        return []
    first = np.diagonal(F[~whole], axis1=1, axis2=2)
    nearest = first[np.argmin(np.sum(np.log(first) ** 2, axis=1))]
    return [f"not finite, nearest to rest at principal stretches {', '.join(f'{s:.3g}' for s in nearest)}"]


def _lost(
    material: Material, kind: str, stretches: tuple[float, float], nothing: float
) -> tuple[float | None, float | None]:
    """Where, going from rest down and up, the least modulus of a wave falls to nothing."""
    if kind == "shear":
        stretch = min(stretches[1], 1 / stretches[0])
        ends: Sequence[float] = (stretch - 1 / stretch,)
    else:
        ends = stretches
    found = [_first(material, kind, end, nothing) for end in ends]
    return (None, found[0]) if len(found) == 1 else (found[0], found[1])


def _first(material: Material, kind: str, end: float, nothing: float) -> float | None:
    start = rest(kind)
    along = np.linspace(start, end, 2 + int(abs(end - start) / PATH))
    F = deformation_gradient(material, kind, along)
    along = along[np.all(np.isfinite(F), axis=(1, 2))]
    moduli = least_wave_modulus(material, F[np.all(np.isfinite(F), axis=(1, 2))])
    bad = np.flatnonzero(~(moduli > nothing))
    if not len(bad):
        return None
    k = int(bad[0])
    if k == 0 or not np.isfinite(moduli[k]):
        return float(along[k])
    share = (moduli[k - 1] - nothing) / (moduli[k - 1] - moduli[k])  # a straight line between two points
    return float(along[k - 1] + share * (along[k] - along[k - 1]))
