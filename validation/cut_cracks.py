"""Cracks with closed forms: a penny in an infinite body, and uniform stress along a cut.

Two halves also turn apart. The penny (Sneddon, Proc. R. Soc. A 187, 1946) of radius a opens under a tension s by
8 (1 - nu^2) s sqrt(a^2 - r^2) / (pi E) and releases G = 4 (1 - nu^2) s^2 a / (pi E). The surface of a block has the
displacements of the infinite body, which follow from the opening by Somigliana's integral. `cuts.py` runs the parts.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.core.arrays import Floats
from palpate.meshfree.cut.surface import swept

SPACING = 1e-3
YOUNG, TENSION = 3e3, 0.03  # [Pa]; strains of 1e-5
CORNERS = 64  # of the polygon that stands for a disc
TOLERANCE = 1e-5  # of the statics
OBLIQUE, JITTER = (1.0, 2.0, 3.0), 0.25
BLOCK = np.array([16, 14, 15]) * SPACING  # of patch test and halves
PLANES = {  # height in spacings and normal of the plane of a patch test
    "between nodes": (7.5, (0.0, 0.0, 1.0)), "on nodes": (7.0, (0.0, 0.0, 1.0)), "oblique": (7.4, (0.3, 0.2, 1.0)),
}  # fmt: skip


def tissue(poisson: float, young: float = YOUNG) -> pt.materials.Material:
    return pt.materials.MooneyRivlin(C1=young / (2 * (1 + poisson)), C2=0.0, poisson=poisson, density=1000.0)


def frame(normal: Floats) -> tuple[Floats, Floats, Floats]:
    """Return a unit normal, and two unit vectors across it."""
    normal = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    first = np.linalg.svd(normal[None])[2][1]
    return normal, first, np.cross(normal, first)


def disc(center: Floats, normal: Floats, radius: float) -> Floats:
    """Triangles (t, 3, 3) [m] of a regular polygon that has the area of a disc."""
    _, first, second = frame(normal)
    outer = radius * np.sqrt(2 * np.pi / (CORNERS * np.sin(2 * np.pi / CORNERS)))
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    ring = center + outer * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
    return np.stack([np.broadcast_to(center, ring.shape), ring, np.roll(ring, -1, axis=0)], axis=1)


def rectangle(center: Floats, normal: Floats, length: float, reach: float) -> Floats:
    """Triangles of a rectangle normal to a direction, from `reach` behind to `length` beyond its centre along x."""
    normal = frame(normal)[0]
    along = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    along /= np.linalg.norm(along)
    ends = np.array([center - reach * along, center + length * along])
    return swept(ends[:, None] + (reach * np.array([-1.0, 1.0])[:, None] * np.cross(normal, along))[None])


def penny_displacements(points: Floats, radius: float, poisson: float, center: Floats, normal: Floats) -> Floats:
    """Displacements (n, 3) [m] at places off a penny crack under tension.

    Integral of the opening times the stress of a unit force (Kelvin's solution), by Gauss's rule in the angle whose
    sine is r / a, and the uniform strain of the tension.
    """
    normal, first, second = frame(normal)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    turn = (nodes + 1) * np.pi / 4
    r, opening = radius * np.sin(turn), opening_at(0.0, radius, poisson) * np.cos(turn)
    ring = weights * np.pi / 4 * radius * np.cos(turn) * r * opening
    angle = 2 * np.pi * (np.arange(48) + 0.5) / 48
    around = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    places = (r[:, None, None] * around).reshape(-1, 3) + center
    share = np.repeat(ring, 48) * 2 * np.pi / 48
    u = np.zeros_like(points)
    for start in range(0, len(points), 2000):
        way = places - points[start : start + 2000, None]
        distance = np.linalg.norm(way, axis=2)
        way /= distance[..., None]
        along = way @ normal
        kernel = -((3 * along**2)[..., None] * way) - (1 - 2 * poisson) * (2 * along[..., None] * normal - way)
        u[start : start + 2000] = np.einsum("xqc,xq->xc", kernel, share / distance**2) / (8 * np.pi * (1 - poisson))
    offset = points - center
    return u + TENSION / YOUNG * ((1 + poisson) * (offset @ normal)[:, None] * normal - poisson * offset)


def opening_at(r: float, radius: float, poisson: float) -> float:
    """Opening [m] of a penny crack."""
    return float(8 * (1 - poisson**2) * TENSION / (np.pi * YOUNG) * np.sqrt(radius**2 - r**2))


def jump(points: Floats, u: Floats, place: Floats, normal: Floats) -> float:
    """Opening [m] at a place in the plane of a cut, from quadratic fits on either side."""
    normal, first, second = frame(normal)
    offset = (points - place) / SPACING
    x, y, z = offset @ first, offset @ second, offset @ normal
    values, above = [], z > -1e-6  # a node on the plane is on the side of the normal
    for side in (above, ~above):
        near = side & (np.hypot(x, y) < 2.3) & (np.abs(z) < 3.2)
        a, b, c = x[near], y[near], z[near]
        terms = np.column_stack([np.ones(len(a)), a, b, c, a * a, b * b, c * c, a * b, a * c, b * c])
        values.append(np.linalg.lstsq(terms, u[near] @ normal, rcond=None)[0][0])
    return float(values[0] - values[1])


def penny(radius: int, poissons: list[float], normal: Floats, jitter: float, half_width: float) -> list[dict]:
    """Errors of the opening and of the energy release of a penny of some spacings' radius."""
    cells = int(np.ceil(2 * half_width * radius))
    cells += 1 - cells % 2  # the centre is midway between nodes
    cloud = pt.box((cells * SPACING,) * 3, SPACING, jitter=jitter)
    cloud = cloud.with_group("all", np.unique(cloud.face_nodes))
    center, a = np.full(3, 0.5 * cells * SPACING), radius * SPACING
    unit, first, _ = frame(normal)
    rows = []
    for poisson in poissons:
        begin = time.perf_counter()
        outer = penny_displacements(cloud.points[cloud.group("all")], a, poisson, center, normal)
        loads = [pt.PrescribedMotion("all", lambda p, t, outer=outer: outer)]
        body, states, u = pt.Solid(cloud, tissue(poisson)), {}, None
        for step in (0, -1, 1):
            cut = pt.cut(body, disc(center, unit, a + step * SPACING))
            states[step] = cut, pt.equilibrium(cut, loads, displacement=u, tolerance=TOLERANCE)
            u = states[0][1].displacements
        cut = states[0][0]
        release = 4 * (1 - poisson**2) * TENSION**2 * a / (np.pi * YOUNG)
        area = np.pi * ((a + SPACING) ** 2 - (a - SPACING) ** 2)
        found = (states[-1][1].strain_energy - states[1][1].strain_energy) / area
        rows.append({
            "radius": radius, "poisson": poisson, "normal": list(normal), "jitter": jitter, "nodes": len(cloud),
            "center": jump(cloud.points, u, center, unit) / opening_at(0.0, a, poisson) - 1,
            "half": jump(cloud.points, u, center + 0.5 * a * first, unit) / opening_at(0.5 * a, a, poisson) - 1,
            "release": found / release - 1,
            "frequency": cut.stability.highest_frequency / body.stability.highest_frequency,
            "released": len(cut.released_nodes), "seconds": time.perf_counter() - begin,
        })  # fmt: skip
        row = rows[-1]
        print(
            f"penny a = {radius} h, {len(cloud)} nodes, nu {poisson}, normal {tuple(normal)}, jitter {jitter}: opening "
            f"{row['center']:+.2%}, at a/2 {row['half']:+.2%}, release {row['release']:+.2%}, frequency "
            f"{row['frequency']:.2f}, released {row['released']}, {row['seconds']:.0f} s", flush=True,
        )  # fmt: skip
    return rows


def patch(place: str, jitter: float) -> dict:
    """Largest force on an inner node under a uniform stress along a cut that ends in the body, over stress h^2."""
    height, normal = PLANES[place]
    unit = frame(np.array(normal))[0]
    cloud = pt.box(BLOCK, SPACING, jitter=jitter, seed=1)
    body, law = pt.Solid(cloud, tissue(0.45)), tissue(0.45)
    center = np.array([0.5 * BLOCK[0], 0.5 * BLOCK[1], height * SPACING])
    cut = pt.cut(body, rectangle(center, unit, 0.0, 0.05))
    along = np.cross(unit, [0.0, 1.0, 0.0])
    along /= np.linalg.norm(along)
    strain = 1e-6 * (np.outer(along, along) - law.lame / (law.lame + 2 * law.shear_modulus) * np.outer(unit, unit))
    stress = 2 * law.shear_modulus * strain + law.lame * np.trace(strain) * np.eye(3)
    inner = np.setdiff1d(np.arange(len(cloud)), cloud.face_nodes)
    scale = np.abs(stress).max() * SPACING**2
    uncut, opened = (
        (each.force(cloud.points @ strain) * each.volumes[:, None])[inner] / scale for each in (body, cut)
    )  # fmt: skip
    row = {
        "place": place, "jitter": jitter, "nodes": len(cloud), "uncut": float(np.abs(uncut).max()),
        "cut": float(np.abs(opened).max()), "change": float(np.abs(opened - uncut).max()),
    }  # fmt: skip
    print(f"patch {place}, jitter {jitter}: " + ", ".join(f"{k} {row[k]:.1e}" for k in ("uncut", "cut", "change")))
    return row


def halves(jitter: float) -> dict:
    """Energy over mu V, and largest force over mu h^2, of halves that turn by 0.9 and 0.7 rad and move apart."""
    cloud = pt.box(BLOCK, SPACING, jitter=jitter, seed=1)
    height, normal = PLANES["oblique"]
    unit = frame(np.array(normal))[0]
    center, law = np.array([0.5 * BLOCK[0], 0.5 * BLOCK[1], height * SPACING]), tissue(0.45)
    cut = pt.cut(pt.Solid(cloud, law), rectangle(center, unit, 0.05, 0.05))
    upper, axes = (cloud.points - center) @ unit > -1e-6 * SPACING, np.array([[0.4, -0.3, 0.8], [-0.7, 0.2, 0.1]])
    turns = Rotation.from_rotvec(axes * (np.array([0.9, 0.7]) / np.linalg.norm(axes, axis=1))[:, None]).as_matrix()
    turned = [cloud.points @ turn.T for turn in turns]
    u = np.where(upper[:, None], turned[0] + (0.01, 0.0, 0.02), turned[1]) - cloud.points
    row = {
        "jitter": jitter, "nodes": len(cloud), "released": len(cut.released_nodes),
        "energy": cut.strain_energy(u) / (law.shear_modulus * cut.volumes.sum()),
        "force": float(np.abs(cut.force(u) * cut.volumes[:, None]).max()) / (law.shear_modulus * SPACING**2),
    }  # fmt: skip
    print(f"halves, jitter {jitter}: energy {row['energy']:.1e}, force {row['force']:.1e}", flush=True)
    return row
