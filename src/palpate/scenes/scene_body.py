"""The body of a scene and its loads: nodes, groups, supports and regions, made from its `Description`.

`palpate.scenes.organ_scene` imports this module when a body is first used, since mechanics take a second to import.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats, Ints
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
from palpate.faults import InputError
from palpate.meshfree.cloud import BORDER_MARGIN, MOVED_MARGIN, Cloud, box
from palpate.meshfree.filling import BODY_PREFIX, fill
from palpate.meshfree.sheets import disc
from palpate.scenes.names import TOOL_GROUP, SceneKind
from palpate.scenes.places import PlaceFinder, side_mask
from palpate.scenes.scene_source import SceneSource, group_name, naming
from palpate.scenes.tissue import fibres_of, material_of
from palpate.tissue.materials import Material

DEFAULT_SIDE = "back"  # away from the first view of the page
MIN_HELD, MAX_HELD_SHARE = 3, 0.6  # nodes of a body that supports hold


def scene_cloud(scene: SceneSource) -> Cloud:
    """Return the nodes of the body, with groups of its supports, regions and loads; see `OrganScene.cloud`."""
    cloud = _filled(scene)
    finder = _finder(scene, cloud)
    for number, region in enumerate(scene.description.region):
        with naming(scene, "region", number):
            cloud = _with_group(cloud, group_name(scene, "region", number), finder.mask(region.place))
    for number, support in enumerate(scene.description.support):
        with naming(scene, "support", number):
            mask = finder.mask(support.place, margin=0.0 if support.kind == "springs" else BORDER_MARGIN)
            if support.surface_only or support.kind == "springs":
                mask = _on_surface(cloud, mask)
            cloud = _with_group(cloud, group_name(scene, "support", number), mask)
    if not scene.description.support:
        cloud = cloud.with_group(group_name(scene, "support", 0), _default_support(cloud))
        if scene.kind is SceneKind.SCENE_FILE:
            scene.notes.append(
                f"support: the scene has none, so the side {DEFAULT_SIDE!r} of the body is held; give [[support]]"
            )
    for number, load in enumerate(scene.description.load):
        if load.place is not None:
            with naming(scene, "load", number):
                mask = finder.mask(load.place, margin=MOVED_MARGIN if load.kind == "motion" else 0.0)
                mask = mask if load.kind == "motion" else _on_surface(cloud, mask)
                cloud = _with_group(cloud, group_name(scene, "load", number), mask)
    _check_supports(scene, cloud)
    return cloud


def check_disc(scene: SceneSource) -> None:
    """Raise `InputError` for what a disc cannot be, before it has nodes."""
    about = scene.description
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


def scene_body(
    scene: SceneSource, cloud: Cloud, foundations: tuple[Foundation, ...]
) -> tuple[Solid | Membrane, Floats | None]:
    """Return the full model of the body, and its displacements (n, 3) [m] at the start, under loads; None without."""
    about = scene.description
    fixed = [each for each in (_support(scene, cloud, k) for k in range(len(about.support) or 1)) if each is not None]
    if about.surface.generated == "disc":
        assert about.body.thickness is not None  # `check_disc`
        membrane = Membrane(
            cloud, scene.material, about.body.thickness, fixed, prestretch=about.body.prestretch,
            mass_damping=about.tissue.mass_damping,
            fibres=None if about.tissue.fibres is None else fibres_of(about.tissue.fibres),
        )  # fmt: skip
        return membrane, None
    materials: dict[str, Material] = {"": scene.material}
    for number, region in enumerate(about.region):
        if region.parameters:
            with naming(scene, "region", number):
                materials[group_name(scene, "region", number)] = material_of(about.tissue, region.parameters)
    body = Solid(
        cloud, materials if len(materials) > 1 else scene.material, fixed, form=about.body.form,
        mass_damping=about.tissue.mass_damping, stiffness=_stiffness_factors(scene, cloud, materials),
        fibres=None if about.tissue.fibres is None else fibres_of(about.tissue.fibres),
    )  # fmt: skip
    motions = free_rigid_motions(cloud.points, body.constrain(np.zeros(len(cloud), dtype=bool)))
    if motions and not foundations:
        raise InputError(
            f"supports must hold the body, got {motions} rigid motions left free; fix a part, or use springs"
        )
    if not about.body.under_loads:
        return body, None
    with naming(scene, "body", "under_loads"):
        at_rest = unloaded(body, _loads_of_shape(scene, foundations))
    sag = float(np.linalg.norm(at_rest.displacements, axis=1).max())
    scene.notes.append(
        f"body: its stress-free shape is up to {1e3 * sag:.3g} mm from the surface, which loads have deformed; "
        "runs begin in that shape, a view and training in the stress-free one"
    )
    return at_rest.body, at_rest.displacements


def scene_foundations(scene: SceneSource) -> tuple[Foundation, ...]:
    """Return the springs per area, which act in every run."""
    return tuple(
        Foundation(group_name(scene, "support", number), support.stiffness, support.damping)
        for number, support in enumerate(scene.description.support)
        if support.kind == "springs"
    )


def scene_loads(scene: SceneSource, foundations: tuple[Foundation, ...]) -> tuple[Load, ...]:
    """Return the loads of a single run, with the foundations."""
    return (*foundations, *(_load(scene, number) for number in range(len(scene.description.load))))


def _loads_of_shape(scene: SceneSource, foundations: tuple[Foundation, ...]) -> tuple[Load, ...]:
    """Return the loads at time 0 that have deformed the surface."""
    loads = scene.description.load
    if not any(np.interp(0.0, load.times, load.factors) for load in loads):
        raise InputError(
            "under_loads must be false without loads at time 0, got true; give a [[load]] of kind = 'gravity' "
            "whose factor at 0 s is not 0"
        )
    if any(load.kind == "motion" for load in loads):
        raise InputError("under_loads must be false with a load of kind 'motion', got true; give a force")
    return scene_loads(scene, foundations)


def _stiffness_factors(scene: SceneSource, cloud: Cloud, materials: dict[str, Material]) -> Floats | None:
    """Return factors (n,) that give every node the mean compliance of its cell; None where all are 1.

    A node has the parameters of the region it lies in; its factor makes up for the part of its cell in others.
    """
    if not scene.description.region:
        return None
    nodal = np.full(len(cloud), scene.material.shear_modulus)
    modulus, finder = nodal.copy(), _finder(scene, cloud)
    for number, region in enumerate(scene.description.region):
        group = group_name(scene, "region", number)
        inside = materials.get(group, scene.material).shear_modulus
        nodal[cloud.group(group)] = inside
        share = finder.fractions(region.place)
        modulus = 1.0 / ((1.0 - share) / modulus + share / (region.stiffness * inside))
    return None if np.allclose(modulus, nodal, rtol=1e-12) else modulus / nodal


def _filled(scene: SceneSource) -> Cloud:
    about = scene.description
    if not about.body.spacing:
        raise InputError("spacing of [body] must be given, got none; give one, such as spacing = '5 mm'")
    if about.surface.generated == "box":
        size = [about.surface.scale * edge for edge in about.surface.size]
        return box(size, about.body.spacing)
    if about.surface.generated == "disc":
        cloud = disc(about.surface.scale * about.surface.disc_radius, about.body.spacing)
        radius = about.tool.hold_radius
        return cloud.within(TOOL_GROUP, (0.0, 0.0), radius, margin=0.0) if radius else cloud
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        surface = scene.repaired_surface
        assert surface is not None
        cloud = fill(surface, about.body.spacing, seed=about.body.seed)
    noted = {*surface.warnings, *(repair.what for repair in surface.repairs)}
    scene.notes += [f"surface: {line}" for line in sorted({str(each.message) for each in caught} - noted)]
    return cloud


def _finder(scene: SceneSource, cloud: Cloud) -> PlaceFinder:
    unit, space = (1.0, "") if scene.surface is None else (scene.surface.unit, scene.surface.space)
    return PlaceFinder(cloud, scene.description.surface, unit, scene.folder, space)


def _default_support(cloud: Cloud) -> NDArray[np.bool_]:
    """Return the side of each body away from the first view."""
    if cloud.points.shape[1] == 2:
        raise InputError("support must be given for a disc, got none; give [[support]] with place = { group = 'rim' }")
    mask = np.zeros(len(cloud), dtype=bool)
    for nodes, _ in _bodies(cloud):
        mask[nodes] = side_mask(cloud.points[nodes], DEFAULT_SIDE, BORDER_MARGIN * cloud.spacing)
    return mask


def _support(scene: SceneSource, cloud: Cloud, number: int) -> BodySupport | None:
    """Return a support of the body; None for springs, which are a load."""
    group = group_name(scene, "support", number)
    if not scene.description.support:
        return Clamp(group)
    support = scene.description.support[number]
    with naming(scene, "support", number):
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


def _load(scene: SceneSource, number: int) -> Load:
    load, group = scene.description.load[number], group_name(scene, "load", number)
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


def _check_supports(scene: SceneSource, cloud: Cloud) -> None:
    """Raise `InputError` for supports that hold too little or too much of a body."""
    kinds = [each.kind for each in scene.description.support] or ["fixed"]
    groups = {kind: np.zeros(len(cloud), dtype=bool) for kind in ("fixed", "springs", "roller", "rail")}
    for number, kind in enumerate(kinds):
        groups[kind][cloud.group(group_name(scene, "support", number))] = True
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
