"""The body of a `Description` and its loads: nodes, groups, supports and regions.

`palpate.scenes.scene` imports this module when a body is first used, since mechanics take a second to import. Errors of
an entry are a `Fault`, whose place in a file the scene adds.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.pressure import Pressure
from palpate.dynamics.loads.supports import Clamp, Rail, Roller, free_rigid_motions
from palpate.dynamics.loads.supports import Support as BodySupport
from palpate.dynamics.loads.surface_force import SurfaceForce
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.solid.model import Solid
from palpate.dynamics.solid.unloading import unloaded
from palpate.meshfree.cloud import BORDER_MARGIN, MOVED_MARGIN, Cloud, box
from palpate.meshfree.fill_surface import BODY_PREFIX
from palpate.meshfree.filling import fill
from palpate.meshfree.sheets import disc
from palpate.scenes.description import Description
from palpate.scenes.names import TOOL_GROUP
from palpate.scenes.places import PlaceFinder, side_mask
from palpate.scenes.scene_text import at_entry
from palpate.scenes.tissue import fibres_of, material_of
from palpate.surface.surface import Surface
from palpate.tissue.materials import Material

DEFAULT_SIDE = "back"  # away from the first view of the page
MIN_HELD, MAX_HELD_SHARE = 3, 0.6  # nodes of a body that supports hold


def make_cloud(about: Description, surface: Surface | None, folder: Path) -> tuple[Cloud, list[str]]:
    """Return the nodes of the body, with groups of its supports, regions and loads, and notes about the filling.

    The surface to fill is None for a box or a disc. `folder` is that of relative file names.
    """
    cloud, notes = _fill(about, surface)
    places = _places(about, cloud, surface, folder)
    for number, region in enumerate(about.region):
        with at_entry("region", number):
            cloud = _with_group(cloud, about.group_name("region", number), places.mask(region.place))
    for number, support in enumerate(about.support):
        with at_entry("support", number):
            mask = places.mask(support.place, margin=0.0 if support.kind == "springs" else BORDER_MARGIN)
            if support.surface_only or support.kind == "springs":
                mask = _on_surface(cloud, mask)
            cloud = _with_group(cloud, about.group_name("support", number), mask)
    if not about.support:
        cloud = cloud.with_group(about.group_name("support", 0), _default_support(cloud))
    for number, load in enumerate(about.load):
        if load.place is not None:
            with at_entry("load", number):
                mask = places.mask(load.place, margin=MOVED_MARGIN if load.kind == "motion" else 0.0)
                mask = mask if load.kind == "motion" else _on_surface(cloud, mask)
                cloud = _with_group(cloud, about.group_name("load", number), mask)
    _check_supports(about, cloud)
    return cloud, notes


def check_spacing(about: Description) -> None:
    """Raise `InputError` without a spacing, before a file is read."""
    if not about.body.spacing:
        raise InputError("spacing of [body] must be given, got none; give one, such as spacing = '5 mm'")


def check_disc(about: Description) -> None:
    """Raise `InputError` for what a disc cannot be, before it has nodes."""
    if about.surface.generated != "disc":
        return
    if about.body.under_loads:
        raise InputError("under_loads of [body] must be false for a disc, got true; use prestretch")
    if about.body.thickness is None:
        raise InputError("thickness of [body] must be given for a disc, got none; give thickness = '0.1 mm'")
    if about.body.form != "energy":
        raise InputError(f"form of [body] must be energy for a disc, got {about.body.form}; leave form out")
    if about.region:
        raise InputError(f"region must be left out for a disc, got {len(about.region)}; give one tissue")


def make_body(
    about: Description, material: Material, cloud: Cloud, surface: Surface | None, folder: Path
) -> tuple[Solid | Membrane, Floats | None]:
    """Return the full model of the body, and its displacements (n, 3) [m] at the start, under loads; None without.

    `material` is that outside all regions; `cloud` is that of `make_cloud`.
    """
    fixed = [each for each in (_support(about, cloud, k) for k in range(len(about.support) or 1)) if each is not None]
    if about.surface.generated == "disc":
        assert about.body.thickness is not None  # `check_disc`
        membrane = Membrane(
            cloud, material, about.body.thickness, fixed, prestretch=about.body.prestretch,
            mass_damping=about.tissue.mass_damping,
            fibres=None if about.tissue.fibres is None else fibres_of(about.tissue.fibres),
        )  # fmt: skip
        return membrane, None
    materials: dict[str, Material] = {"": material}
    for number, region in enumerate(about.region):
        if region.parameters:
            with at_entry("region", number):
                materials[about.group_name("region", number)] = material_of(about.tissue, region.parameters)
    body = Solid(
        cloud, materials if len(materials) > 1 else material, fixed, form=about.body.form,
        mass_damping=about.tissue.mass_damping,
        stiffness=_stiffness_factors(about, materials, _places(about, cloud, surface, folder)),
        fibres=None if about.tissue.fibres is None else fibres_of(about.tissue.fibres),
    )  # fmt: skip
    motions = free_rigid_motions(cloud.points, body.constrain(np.zeros(len(cloud), dtype=bool)))
    if motions and not foundations_of(about):
        raise InputError(
            f"supports must hold the body, got {motions} rigid motions left free; fix a part, or use springs"
        )
    if not about.body.under_loads:
        return body, None
    with at_entry("body", "under_loads"):
        at_rest = unloaded(body, _loads_of_shape(about))
    return at_rest.body, at_rest.displacements


def foundations_of(about: Description) -> tuple[Foundation, ...]:
    """Return the springs per area, which act in every run."""
    return tuple(
        Foundation(about.group_name("support", number), support.stiffness, support.damping)
        for number, support in enumerate(about.support)
        if support.kind == "springs"
    )


def loads_of(about: Description) -> tuple[Load, ...]:
    """Return the loads of a single run, with the foundations."""
    return (*foundations_of(about), *(_load(about, number) for number in range(len(about.load))))


def _loads_of_shape(about: Description) -> tuple[Load, ...]:
    """Return the loads at time 0 that have deformed the surface."""
    loads = about.load
    if not any(np.interp(0.0, load.times, load.factors) for load in loads):
        raise InputError(
            "under_loads must be false without loads at time 0, got true; give a [[load]] of kind = 'gravity' "
            "whose factor at 0 s is not 0"
        )
    if any(load.kind == "motion" for load in loads):
        raise InputError("under_loads must be false with a load of kind 'motion', got true; give a force")
    return loads_of(about)


def _stiffness_factors(about: Description, materials: dict[str, Material], places: PlaceFinder) -> Floats | None:
    """Return factors (n,) that give every node the mean compliance of its cell; None where all are 1.

    A node has the parameters of the region it lies in; its factor makes up for the part of its cell in others.
    """
    if not about.region:
        return None
    nodal = np.full(len(places.cloud), materials[""].shear_modulus)
    modulus = nodal.copy()
    for number, region in enumerate(about.region):
        group = about.group_name("region", number)
        inside = materials.get(group, materials[""]).shear_modulus
        nodal[places.cloud.group(group)] = inside
        share = places.fractions(region.place)
        modulus = 1.0 / ((1.0 - share) / modulus + share / (region.stiffness * inside))
    return None if np.allclose(modulus, nodal, rtol=1e-12) else modulus / nodal


def _fill(about: Description, surface: Surface | None) -> tuple[Cloud, list[str]]:
    """Return nodes without groups, and notes about the filling that the surface does not have."""
    assert about.body.spacing is not None  # `check_spacing`
    if about.surface.generated == "box":
        return box([about.surface.scale * edge for edge in about.surface.size], about.body.spacing), []
    if about.surface.generated == "disc":
        cloud = disc(about.surface.scale * about.surface.disc_radius, about.body.spacing)
        radius = about.tool.hold_radius
        return (cloud.within(TOOL_GROUP, (0.0, 0.0), radius, margin=0.0) if radius else cloud), []
    assert surface is not None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cloud = fill(surface, about.body.spacing, seed=about.body.seed)
    noted = {*surface.warnings, *(repair.what for repair in surface.repairs)}
    return cloud, [f"surface: {line}" for line in sorted({str(each.message) for each in caught} - noted)]


def _places(about: Description, cloud: Cloud, surface: Surface | None, folder: Path) -> PlaceFinder:
    unit, space = (1.0, "") if surface is None else (surface.unit, surface.space)
    return PlaceFinder(cloud, about.surface, unit, folder, space)


def _default_support(cloud: Cloud) -> NDArray[np.bool_]:
    """Return the side of each body away from the first view."""
    if cloud.points.shape[1] == 2:
        raise InputError("support must be given for a disc, got none; give [[support]] with place = { group = 'rim' }")
    mask = np.zeros(len(cloud), dtype=bool)
    for nodes, _ in _bodies(cloud):
        mask[nodes] = side_mask(cloud.points[nodes], DEFAULT_SIDE, BORDER_MARGIN * cloud.spacing)
    return mask


def _support(about: Description, cloud: Cloud, number: int) -> BodySupport | None:
    """Return a support of the body; None for springs, which are a load."""
    group = about.group_name("support", number)
    if not about.support:
        return Clamp(group)
    support = about.support[number]
    with at_entry("support", number):
        if support.kind == "roller":
            return _roller(cloud, group, support.direction)
        if support.kind == "rail":
            return Rail(group, support.direction)
    return Clamp(group) if support.kind == "fixed" else None


def _roller(cloud: Cloud, group: str, direction: Sequence[float]) -> Roller:
    roller = Roller(group, direction or None)
    if not direction:
        try:
            roller.directions(cloud)
        except InputError as error:
            raise InputError(
                f"direction must be given for a roller on {group!r}, whose nodes are not one face, got none; give "
                "its normal, such as direction = [0, 0, 1]"
            ) from error
    return roller


def _load(about: Description, number: int) -> Load:
    load, group = about.load[number], about.group_name("load", number)
    times, factors = np.array(load.times), np.array(load.factors)

    def factor(time: float) -> float:
        return float(np.interp(time, times, factors))

    def scaled_vector(vector: Sequence[float]) -> Callable[[float], Sequence[float]]:
        return lambda time: [factor(time) * each for each in vector]

    if load.kind == "force":
        return SurfaceForce(group, force=scaled_vector(load.force))
    if load.kind == "pressure":
        return Pressure(group, lambda time: factor(time) * load.pressure)
    if load.kind == "gravity":
        return Gravity(scaled_vector(load.acceleration))
    return PrescribedMotion(group, lambda points, time: factor(time) * np.array(load.displacement))


def _check_supports(about: Description, cloud: Cloud) -> None:
    """Raise `InputError` for supports that hold too little or too much of a body."""
    kinds = [each.kind for each in about.support] or ["fixed"]
    groups = {kind: np.zeros(len(cloud), dtype=bool) for kind in ("fixed", "springs", "roller", "rail")}
    for number, kind in enumerate(kinds):
        groups[kind][cloud.group(about.group_name("support", number))] = True
    fixed, springs = groups["fixed"], groups["springs"]
    sliding = groups["roller"] | groups["rail"]
    bodies = _bodies(cloud)
    for nodes, where in bodies:
        count = int(fixed[nodes].sum())
        if fixed[nodes].mean() > MAX_HELD_SHARE:
            raise InputError(
                f"fixed must leave tissue free, got {fixed[nodes].mean():.0%} of the nodes{where} held; hold a "
                "smaller part"
            )
        if count < MIN_HELD and not springs[nodes].any() and not sliding[nodes].any():
            raise InputError(f"fixed must hold at least {MIN_HELD} nodes{where}, got {count}; hold a larger part")


def _bodies(cloud: Cloud) -> list[tuple[Ints, str]]:
    """Return the nodes of each body of a cloud, and its name for messages, empty for one alone."""
    names = [name for name in cloud.groups if name.startswith(f"{BODY_PREFIX} ")]
    if not names:
        return [(np.arange(len(cloud)), "")]
    return [(cloud.group(name), f" of {name} of {len(names)}") for name in names]


def _with_group(cloud: Cloud, name: str, mask: NDArray[np.bool_]) -> Cloud:
    """Return the cloud with a group; the cloud itself if it has this one."""
    if name in cloud.groups and np.array_equal(cloud.groups[name], np.flatnonzero(mask)):
        return cloud
    return cloud.with_group(name, mask)


def _on_surface(cloud: Cloud, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the nodes of a mask that are on the surface."""
    if cloud.points.shape[1] == 2:
        return mask
    on = np.zeros(len(cloud), dtype=bool)
    on[cloud.face_nodes] = True
    if not np.any(mask & on):
        raise InputError("place must hold nodes of the surface, got inner nodes only; make it larger")
    return np.asarray(mask & on)
