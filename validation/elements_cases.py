"""Bodies and loads of validation/elements.py: geometry alone, which finite elements and palpate both read.

A case is a closed surface with a support, a spot to load, and the loads there. Its triangles follow the border of the
support and that of a disc about the spot, the patch. Lengths are relative to ``spacing``, at which `palpate.fill`
gives about 3,000 nodes. SI units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from elements_mesh import collapse_short, icosphere, level_split, subdivide

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
C1, DENSITY, POISSON = 1100.0, 1060.0, 0.45  # [Pa], [kg/m^3]
SUPPORT = 0.15  # of the extent along an axis, held
PATCH, SMOOTH = 1.5, 2.5  # radii of the patch and of the smooth pressure, in spacings
RADII, DEPTHS = (1.0, 1.5, 2.0, 3.0), (0.25, 0.5, 0.75, 1.0)  # of balls, in spacings; depths in radii
LOCAL, GROWTH = 0.4, 0.35  # edges [spacings] of the shared triangles within 2.5 spacings of the spot; their growth
BONE, MUSCLE, LIMB, LIMB_LENGTH = 0.015, 0.045, 0.060, 0.150  # radii of the cylinder's layers, and its length [m]


@dataclass(frozen=True)
class Case:
    """A body, its support and its loads.

    Attributes
    ----------
    vertices, faces : arrays (v, 3) [m], (t, 3)
        Closed surface, triangles counter-clockwise from outside.
    axis, plane : int, float [m]
        Surface points whose coordinate `axis` is at most `plane` are held: see `held`.
    point, normal : arrays (3,)
        The spot, on the surface, and the inward unit normal there.
    patch_radius : float [m]
        Surface points no farther from `point` move rigidly along `normal`.
    smooth_radius : float [m]
        A pressure of 1/2 + 1/2 cos(pi r / smooth_radius), r the distance from `point`, along `normal`.
    spacing : float [m]
        At which `palpate.fill` gives about 3,000 nodes.
    balls : tuple of (radius, depths) [m]
        Rigid, without friction; the depth is the way of its foremost point beyond `point` along `normal`.
    poisson, c1, density : float
        Of the law c1 (I1 - 3) - 2 c1 ln J + lame / 2 (J - 1)^2, ``palpate.materials.NeoHookean``.
    inclusion : (centre, radius, factor) or None
        Ball of other stiffness inside.
    limb : bool
        A tube on a rigid bone: its inner wall is held instead.
    layers : bool
        Whether the inner layer, below 45 mm of radius, is three times as stiff.
    end : float or None [m]
        Face at that x, opposite to the clamp, that the tip loads of the block act on.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    axis: int
    plane: float
    point: np.ndarray
    normal: np.ndarray
    patch_radius: float
    smooth_radius: float
    spacing: float
    balls: tuple[tuple[float, tuple[float, ...]], ...] = ()
    poisson: float = POISSON
    c1: float = C1
    density: float = DENSITY
    inclusion: tuple[np.ndarray, float, float] | None = None
    limb: bool = False
    layers: bool = False
    end: float | None = None
    quantities: tuple[str, ...] = field(default=("frequencies", "sag", "patch", "smooth"))

    def support(self, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, 3) of the surface are from the support [m], negative inside it."""
        if self.limb:
            return np.hypot(points[:, 0], points[:, 1]) - BONE
        return points[:, self.axis] - self.plane

    def factor(self, points: np.ndarray) -> np.ndarray:
        """Return how many times as stiff as the law the tissue at points (n, 3) is."""
        if self.inclusion is not None:
            centre, radius, factor = self.inclusion
            return np.where(np.linalg.norm(points - centre, axis=1) < radius, factor, 1.0)
        if self.layers:
            return np.where(np.hypot(points[:, 0], points[:, 1]) < MUSCLE, 3.0, 1.0)
        return np.ones(len(points))


def case(name: str, data: Path = DATA) -> Case:
    """Return a case of `NAMES`, e.g. "liver", or "liver 0.49" for another Poisson ratio.

    Raises
    ------
    FileNotFoundError
        The surface is not in the data folder.
    """
    if name not in NAMES:
        raise ValueError(f"no case {name!r}: choose from {', '.join(NAMES)}")
    base, _, poisson = name.partition(" ")
    made = MAKERS[base](data)
    return replace(made, name=name, poisson=float(poisson), balls=()) if poisson else made


def _file(path: Path) -> Path:
    if not path.is_file():
        raise FileNotFoundError(f"{path.name} is not in {path.parent}: this case needs the folder of organ surfaces")
    return path


def _balls(spacing: float) -> tuple[tuple[float, tuple[float, ...]], ...]:
    return tuple((round(r * spacing, 6), tuple(round(r * spacing * d, 7) for d in DEPTHS)) for r in RADII)


def _organ(
    name: str, vertices: np.ndarray, faces: np.ndarray, axis: int, spacing: float,
    patch: float | None = None, smooth: float | None = None,
) -> Case:  # fmt: skip
    """Return an organ held at the low end of an axis, its triangles cut at the borders of support and patch."""
    patch, smooth = patch or PATCH * spacing, smooth or SMOOTH * spacing
    low, high = vertices[:, axis].min(), vertices[:, axis].max()
    plane = float(low + SUPPORT * (high - low))
    point, normal = _smooth_spot(vertices, faces, axis, patch)
    return _bordered(name, vertices, faces, axis, plane, point, -normal, spacing, patch, smooth)


def _bordered(name, vertices, faces, axis, plane, point, normal, spacing, patch, smooth) -> Case:
    """Return a case with triangles cut at the borders of patch and support."""
    local = LOCAL / SMOOTH * smooth

    def size(x):
        return np.minimum(1.0, local + GROWTH * np.maximum(np.linalg.norm(x - point, axis=1) - smooth, 0))

    vertices, faces = subdivide(vertices, faces, size)
    vertices, faces = level_split(vertices, faces, lambda x: np.linalg.norm(x - point, axis=1) - patch)
    vertices, faces = level_split(vertices, faces, lambda x: x[:, axis] - plane)
    return Case(name, vertices, faces, axis, plane, point, normal, patch, smooth, spacing, _balls(spacing))


def _smooth_spot(vertices: np.ndarray, faces: np.ndarray, axis: int, patch: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a point far from the support where the surface is smooth, and the outward normal there."""
    corners = vertices[faces]
    vector = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(vector, axis=1)
    area, n, c = 0.5 * length, vector / np.maximum(length, 1e-300)[:, None], corners.mean(axis=1)
    low, high = vertices[:, axis].min(), vertices[:, axis].max()
    candidates = np.flatnonzero(c[:, axis] > low + 0.6 * (high - low))
    best, spot = -1.0, 0
    for k in candidates[:: max(1, len(candidates) // 300)]:
        near = (np.linalg.norm(c - c[k], axis=1) < 2 * patch) & (n @ n[k] > -0.2)
        mean = (area[near, None] * n[near]).sum(axis=0) / area[near].sum()
        score = np.linalg.norm(mean) + 0.3 * mean[axis]
        if score > best:
            best, spot = score, k
    near = (np.linalg.norm(c - c[spot], axis=1) < patch) & (n @ n[spot] > 0)
    normal = (area[near, None] * n[near]).sum(axis=0)
    return c[spot], normal / np.linalg.norm(normal)


def _liver(data: Path) -> Case:
    """A human liver of 2 l, held where y is below 15 % of its extent."""
    return _organ("liver", *_read(data / "hra" / "VH_F_liver_solid_6k.ply"), 1, SPACINGS["liver"], 0.015, 0.025)


def _read(path: Path, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    mesh = trimesh.load(_file(path), process=True)
    return np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces)


def _lobes(data: Path) -> Case:
    """The liver of SOFA, of 0.3 l, held at the low end of z."""
    surface = collapse_short(*_read(data / "sofa" / "liver-smooth.obj", 0.02), 0.001)
    return _organ("lobes", *surface, 2, SPACINGS["lobes"])


def _generated(data: Path) -> Case:
    """The liver-like surface of palpate, 1.5 l, held at the low end of z."""
    import palpate as pt

    surface = pt.liver_surface(resolution=0.008, volume=0.0015)
    return _organ("generated", *collapse_short(surface.vertices, surface.triangles, 0.002), 2, SPACINGS["generated"])


def _kidney(data: Path) -> Case:
    """A bent ellipsoid of 0.2 l, held at both poles, which bend to low y; loaded on its back."""
    sphere, faces = icosphere(np.zeros(3), 1.0, 4)
    x, y, z = (sphere * [0.062, 0.031, 0.026]).T
    bend = 0.070  # radius of the bent axis
    vertices = np.stack([(bend + y) * np.sin(x / bend), (bend + y) * np.cos(x / bend) - bend, z], axis=1)
    corners = vertices[faces]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return _organ("kidney", vertices * (2e-4 / volume) ** (1 / 3), faces, 1, SPACINGS["kidney"])


def _box(low: list[float], high: list[float], edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a box with edges of triangles no longer than given."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return subdivide(np.array(low) + corners * (np.array(high) - low), faces, lambda x: np.full(len(x), edge))


def _slab(data: Path) -> Case:
    """A slab of 120 x 120 x 40 mm with its bottom held, loaded in the middle of its top."""
    vertices, faces = _box([-0.06, -0.06, 0.0], [0.06, 0.06, 0.04], 0.010)
    spacing = SPACINGS["slab"]
    point, normal = np.array([0.0, 0.0, 0.04]), np.array([0.0, 0.0, -1.0])
    return _bordered("slab", vertices, faces, 2, 0.0, point, normal, spacing, PATCH * spacing, SMOOTH * spacing)


def _cylinder(data: Path, layers: bool = True) -> Case:
    """A limb: fat on muscle, three times as stiff, on a rigid bone; loaded from one side, in its middle."""
    angle = 2 * np.pi * np.arange(96) / 96
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    half = LIMB_LENGTH / 2
    rings = [(BONE, -half), (LIMB, -half), (LIMB, half), (BONE, half)]
    vertices = np.concatenate([np.column_stack([r * ring, np.full(96, z)]) for r, z in rings])
    i, j = np.arange(96), (np.arange(96) + 1) % 96
    faces = []
    for k in range(4):
        a, b = 96 * k, 96 * ((k + 1) % 4)
        faces += [np.stack([a + i, a + j, b + j], axis=1), np.stack([a + i, b + j, b + i], axis=1)]
    point, normal = np.array([LIMB, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])
    balls = ((0.010, (0.0025, 0.005, 0.0075, 0.010, 0.0125)),)
    return Case(
        "cylinder" if layers else "cylinder_uniform", vertices, np.concatenate(faces), 2, -1.0, point, normal,
        0.015, 0.025, SPACINGS["cylinder"], balls, limb=True, layers=layers, quantities=("smooth",),
    )  # fmt: skip


def _nodule(data: Path) -> Case:
    """The liver with a ball of tenfold stiffness, of radius 10 mm, whose top is 10 mm below the spot."""
    liver = _liver(data)
    inclusion = (liver.point + 0.020 * liver.normal, 0.010, 10.0)
    balls = ((0.015, (0.005, 0.010)),)
    return replace(liver, name="nodule", inclusion=inclusion, balls=balls, quantities=("smooth",))


def _block(data: Path) -> Case:
    """A beam of 100 x 20 x 20 mm, clamped at x = 0; tougher than the others."""
    vertices, faces = _box([0.0, -0.01, -0.01], [0.1, 0.01, 0.01], 0.010)
    point, normal = np.array([0.1, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])
    return Case(
        "block", vertices, faces, 0, 0.0, point, normal, 0.0, 0.0, SPACINGS["block"], c1=30600.0, density=1120.0,
        end=0.1, quantities=("beam",),
    )  # fmt: skip


# at which palpate.fill gives about 3,000 nodes [m]
SPACINGS = {
    "liver": 0.010, "lobes": 0.0054, "generated": 0.0089, "kidney": 0.0045, "slab": 0.0066, "cylinder": 0.0093,
    "block": 0.00275,
}  # fmt: skip
MAKERS: dict[str, Callable[[Path], Case]] = {
    "liver": _liver, "lobes": _lobes, "generated": _generated, "kidney": _kidney, "slab": _slab,
    "cylinder": _cylinder, "cylinder_uniform": lambda data: _cylinder(data, layers=False), "nodule": _nodule,
    "block": _block,
}  # fmt: skip
NAMES = (*MAKERS, "liver 0.3", "liver 0.49", "generated 0.3", "generated 0.49")
