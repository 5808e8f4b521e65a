"""The tissue of a body: its law with the parameters of every node, fibres, relaxation and stiffness factors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, number_in_range
from palpate.dynamics.material.fibres import prepare_fibres
from palpate.dynamics.material.material_fields import regions_of
from palpate.meshfree.cloud import Cloud
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.materials import Material
from palpate.tissue.regions import Regions


@dataclass(frozen=True)
class TissueField:
    """The material properties of a body at all of its nodes."""

    material: Material  # the law, with the density and the relaxation of all nodes
    regions: Regions | None  # parameters of the law that differ from node to node
    stiffness: Floats  # (n,) array: stiffness factors of the nodes; empty if all are 1
    fibres: FibreLaw | None  # fibres with a direction at every node
    nodes: int

    @property
    def lame(self) -> float:
        """Unit of the nodal volumetric coefficients [Pa]: the material's, or the largest."""
        return self.material.lame if self.regions is None else self.regions.lame

    @property
    def factors(self) -> Floats:
        """Factors (n, 3) of the law, of its shear modulus and of the volumetric coefficient at the nodes."""
        law = self.stiffness if len(self.stiffness) else np.ones(self.nodes)
        if self.regions is None:
            return np.stack([law, law, law], axis=1)
        return np.stack([law, law * self.regions.modulus_ratio, law * self.regions.values("lame") / self.lame], axis=1)

    @property
    def uniform(self) -> bool:
        """Whether all nodes have the same properties, apart from the directions of fibres."""
        return self.regions is None and not len(self.stiffness)

    def moduli(self, name: str) -> Floats:
        """Return a modulus of the material at every node, such as ``"shear_modulus"``, shape (n,)."""
        if self.regions is None:
            return np.full(self.nodes, float(getattr(self.material, name)))
        return self.regions.values(name)

    def stress(self, F: Floats, nodes: Any = slice(None)) -> Floats:
        """Return the first Piola-Kirchhoff stress [Pa] for deformation gradients (k, 3, 3) at nodes."""
        stress = self.material.stress(F) if self.regions is None else self.regions.at(nodes).stress(F)
        if self.fibres is not None:
            stress = stress + self.fibres.of(nodes).stress(F)
        return np.asarray(self.stiffness[nodes, None, None] * stress if len(self.stiffness) else stress)

    def shear_stress(self, F: Floats, nodes: Any = slice(None)) -> Floats:
        """Return the stress [Pa] without the bulk pressure for deformation gradients (k, 3, 3) at nodes."""
        stress = self.material.shear_stress(F) if self.regions is None else self.regions.at(nodes).shear_stress(F)
        return stress if self.fibres is None else stress + self.fibres.of(nodes).stress(F)

    def shear_energy(self, F: Floats) -> Floats:
        """Return the energy density [J/m^3] without the volumetric part for gradients (n, 3, 3), shape (n,)."""
        energy = np.asarray((self.regions or self.material).shear_energy(F))
        return energy if self.fibres is None else energy + self.fibres.energy(F)


def tissue_of(
    cloud: Cloud,
    material: Material | Mapping[str, Material] | Sequence[Material],
    stiffness: Mapping[str, float] | Floats | None,
    fibres: FibreLaw | None,
    form: str,
) -> TissueField:
    """Return the tissue of a cloud in space."""
    first, regions = regions_of(material, cloud)
    if first.incompressible or (regions and any(each.incompressible for each in regions.materials)):
        raise InputError("material of Solid must be compressible, got poisson = 0.5; use at most 0.499")
    directed = prepare_fibres(fibres, first, form, cloud.points)
    return TissueField(first, regions, _stiffness_factors(cloud, stiffness), directed, len(cloud))


def _stiffness_factors(cloud: Cloud, factors: Mapping[str, float] | Floats | None) -> Floats:
    """Return the stiffness factors (n,) of the nodes; empty for None."""
    if factors is None:
        return np.zeros(0)
    if isinstance(factors, Mapping):
        stiffness = np.ones(len(cloud))
        for group, value in factors.items():
            stiffness[cloud.group(group)] = number_in_range(f"stiffness[{group!r}]", value, 0.0, open_low=True)
        return stiffness
    stiffness = np.array(factors, dtype=float)
    if stiffness.shape != (len(cloud),) or not np.all(np.isfinite(stiffness) & (stiffness > 0)):
        raise InputError(f"stiffness must be {len(cloud)} positive numbers, one per node, got shape {stiffness.shape}")
    return stiffness
