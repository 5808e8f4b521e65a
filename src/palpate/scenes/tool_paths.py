"""Random presses of a ball and pulls of forceps on the free surface of any solid body.

A ball comes along the smoothed outward normal n of a surface node. It touches the body first at a height that sphere
tracing finds (Hart, The Visual Computer 12, 1996): the distance to the body is a safe step. The ball reaches the node
if it then is almost at it. In a notch, or between two lobes, it touches something else before. The places from which
it comes must be connected to the outside of the body by a path that is wide enough for it: a grid of its centres
is filled from outside.

The places of training paths are spread over the reachable surface: each is the farthest from those before it among a
few random candidates (Mitchell, SIGGRAPH 1991), so that any number of first ones covers the surface evenly. Those of
other paths are independent of them and of each other.

Held-out paths are touches of a hand at a pointer. The ball approaches its depth exponentially, as on the page. It then
stays, is drawn or flicked aside, or is let go. They are short: errors of many short touches calibrate a bound that
holds for more touches, and a run takes as long as its path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.ndimage as ndimage
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError, integer_in_range, number_in_range
from palpate.dynamics.contact.tools import Contact, Grasp, Sphere
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.solid.model import Solid
from palpate.reduction.hyper.model import ReducedModel
from palpate.scenes.free_surface import FreeSurface
from palpate.scenes.load_case import CAMPAIGN_SEEDS, TRAINING_SEEDS

MIN_RADIUS = 2.0  # [spacings] of the ball, so that nodes resolve the surface under it
CLEARANCE_RADII = 0.2  # [radii] between ball and body near a press; twice that before and after
# [s] away, near, pressed, slid, near, away; of forceps: pulled, turned
PHASE_TIMES = (0.0, 0.02, 0.25, 0.45, 0.58, 0.6)
SLIDE_SHARES = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)  # share of the slide at these times
# Of touches, held-out paths: length [s]; time constant of the approach [s], as page/src/press.js; clearance [radii] at
# the start; time of the next motion [s]; speeds [m/s] by which the ball is drawn aside, flicked aside or let go
TOUCH_SECONDS, TOUCH_TIME, TOUCH_CLEARANCE, NEXT_MOTION = 0.3, 0.07, 0.05, 0.14
DRAW_SPEED, FLICK_SPEED, RELEASE_SPEED = 0.05, 0.2, 0.1
TOUCH_MOTIONS = ("hold", "draw", "flick", "release")
TOUCH_PHASES = (0.0, 0.01, 0.15, 0.3, 0.42, 0.44)  # [s] as `PHASE_TIMES`, of forceps in a hand; the path ends before
SMOOTHING_RADII, MIN_SMOOTHING_SPACINGS = 0.5, 1.5  # [radii], [spacings] width over which normals are smoothed
MAX_GAP = 0.1  # [radii] between a reachable node and the ball that comes along its normal
MAX_DEPTH_RATIO = 0.4  # depth of a press over the thickness of the body below
CELL_RADII = 0.5  # [radii] of the grid of ball centres
MAX_SAG = 0.1  # [depths] by which the middle of a slide may be deeper
MIN_FACING = 0.5  # cosine between the normals at the ends of a slide
GRASP_RADIUS, MIN_GRASP_RADIUS = 0.6, 2.0  # [radii of the ball], [spacings] of forceps: they hold some ten nodes
MAX_PULL_ANGLE, MAX_TURN = np.pi / 4, np.pi / 9  # [rad] largest angle of pulls to the normal; largest rotation
SPREAD_PLACES, CANDIDATES_PER_PLACE = 1000, 32  # places of a campaign that are spread; candidates of each
MAX_TRACES = 40  # steps of sphere tracing
TOUCH_RADII = 0.01  # [radii] distance that counts as touching
MAX_HALVINGS = 4  # of a slide or pull that is obstructed, before it is left out
SLIDE_SAMPLES = 9
# Second tool of a pair: candidates, share of pairs whose nearest candidate is taken, and latest delay [s]
PAIR_CANDIDATES, NEAR_PAIRS, MAX_DELAY, DELAY_STEP = 24, 0.5, 0.15, 0.05
PAIR_SAMPLES = 25  # times at which two tools must be apart
GOLDEN_RATIO = 0.5 * (1 + np.sqrt(5))  # its multiples, less whole numbers, spread evenly between 0 and 1
SECOND_SUFFIX = " 2"  # of the name of a second tool


class _Place(NamedTuple):
    """A press at a surface node: centre of the ball where it touches [m], normal, depth [m]."""

    touch: Floats
    normal: Floats
    depth: float


def check_radius(radius: float, spacing: float) -> None:
    """Raise `InputError` for a ball whose radius [m] is too small for a spacing [m]."""
    if not radius >= MIN_RADIUS * spacing * (1 - 1e-9):
        raise InputError(
            f"radius of [tool] must be at least {MIN_RADIUS:g} spacings = {MIN_RADIUS * spacing:g} m, got "
            f"{radius:g} m; use a larger tool or a finer spacing"
        )


class ToolPaths:
    """Random presses of a ball and pulls of forceps on the free surface of a body; equal seeds give equal paths.

    The ball, ``"tool"``, comes along the outward normal at a place, presses, slides and retracts. Where it begins and
    ends, and on its path, it is outside the undeformed body apart from the indentation under it. Forceps, ``"grasp"``,
    hold the surface nodes around a place, pull, turn, return and release.

    Tools keep at least one radius from nodes that supports fix, forceps one spacing more. A roller, a rail or a
    foundation does not fix its nodes. A press is at most `depth` deep, and at most 0.4 of the thickness of the body
    along the normal, or of the distance to fixed nodes there.

    - `radius` [m]: of the ball, at least 2 spacings; that of forceps is 0.6 times it, or 2 spacings if that is more
    - `depth` [m]: depth of the deepest press and length of the longest pull
    - `slide` [m]: length of the longest slide
    - `grasps`: share of paths that are grasps, evenly spaced: with 0.25 the seeds 3, 7, 11 and so on
    - `shallowest`: depth of the shallowest press and length of the shortest pull, over the largest at its place
    - `others`: further loads of every path, such as foundations
    - `pairs`: share of the held-out paths with a second tool, spread evenly: with 0.5 the numbers 1, 3, 4, 6, 9 and so
      on

    Its arrays over the nodes of `surface`:

    - `reachable`, `graspable` (s,): nodes at which a ball can press, and forceps can hold the body
    - `normals` (s, 3): smoothed outward normals
    - `heights` (s,) [m]: of the ball's centre along the normal where it first touches the body; infinite where it
      cannot come
    - `depths` (s,) [m]: depth of the deepest press at each reachable node; 0 elsewhere
    """

    def __init__(
        self,
        body: Solid | ReducedModel,
        radius: float,
        depth: float,
        friction: float,
        slide: float,
        grasps: float = 0.25,
        shallowest: float = 0.3,
        others: Sequence[Load] = (),
        pairs: float = 0.0,
    ) -> None:
        self.others = tuple(others)
        self.surface = surface = FreeSurface(body)
        spacing = surface.cloud.spacing
        self.radius = number_in_range("radius", radius, unit="m")
        check_radius(self.radius, spacing)
        self.depth = number_in_range("depth", depth, 0.0, open_low=True, unit="m")
        self.friction = number_in_range("friction", friction, 0.0)
        self.slide = number_in_range("slide", slide, 0.0, unit="m")
        self.grasps = number_in_range("grasps", grasps, 0.0, 1.0)
        self.pairs = number_in_range("pairs", pairs, 0.0, 1.0)
        self.shallowest = number_in_range("shallowest", shallowest, 0.0, 1.0, open_low=True)
        self.grasp_radius = max(GRASP_RADIUS * radius, MIN_GRASP_RADIUS * spacing)
        longest = float(np.ptp(surface.points, axis=0).max())
        if 2 * radius >= longest:
            raise InputError(f"radius must be less than half the body's size of {longest:.3g} m, got {radius:g} m")
        self.normals = surface.smoothed_normals(max(SMOOTHING_RADII * radius, MIN_SMOOTHING_SPACINGS * spacing))
        self._samples = cKDTree(np.concatenate([surface.points, _centroids(surface)]))
        self._fixed = cKDTree(surface.fixed_points) if len(surface.fixed_points) else None
        distances = self._to_fixed(surface.points)
        self.heights = self._trace()
        reached = self.heights <= (1 + MAX_GAP) * radius
        self.reachable = reached & ~surface.held & (distances >= radius)
        self.graspable = self.reachable & (distances > self.grasp_radius + spacing)
        self._check_reach(reached, distances)
        self.depths = np.zeros(len(surface.nodes))
        self.depths[self.reachable] = np.minimum(self.depth, MAX_DEPTH_RATIO * self._thickness(self.reachable))
        self._reachable_tree = cKDTree(surface.points[self.reachable])
        self._orders: dict[int, Ints] = {}

    def __call__(self, seed: int) -> tuple[tuple[Load, ...], float]:
        """Return the loads of a path and its duration [s].

        The last six digits of the seed are the number of the path in its campaign. Places of the numbers below 500,000
        are spread over the surface together. Those of others, for held-out runs, are independent.
        """
        is_pair = is_touch(seed) and _is_pair(seed % TRAINING_SEEDS, self.pairs)
        return self.pair(seed) if is_pair else self.single(seed)

    def single(self, seed: int) -> tuple[tuple[Load, ...], float]:
        """Return the loads of a path of one tool and its duration [s]."""
        load, duration = self._draw(seed)
        return (*self.others, load), duration

    def press(self, seed: int) -> tuple[tuple[Contact], float]:
        """Return the load of a ball that presses, slides and retracts, and its duration [s]."""
        random = np.random.default_rng(seed)
        share = random.uniform(self.shallowest, 1.0)
        first = self._node(seed, self.reachable, random)
        start = self._place(first, share)
        end = self._slide_end(first, start, share, random.uniform(-self.slide, self.slide, 3) / np.sqrt(3))
        near, far = CLEARANCE_RADII * self.radius, 2 * CLEARANCE_RADII * self.radius
        share_at = PchipInterpolator(PHASE_TIMES, SLIDE_SHARES)
        height = PchipInterpolator(PHASE_TIMES, (far, near, -start.depth, -end.depth, near, far))

        def motion(time: float) -> Floats:
            at = np.clip(time, PHASE_TIMES[0], PHASE_TIMES[-1])
            centre, normal = _between(start, end, share_at(at)[None])
            return np.asarray(centre[0] + height(at) * normal[0])

        return (Contact(Sphere(self.radius), motion, friction=self.friction),), PHASE_TIMES[-1]

    def touch(self, seed: int) -> tuple[tuple[Contact], float]:
        """Return the load of a ball in a hand at a pointer, and its duration [s]; see `TOUCH_MOTIONS`."""
        random = np.random.default_rng(seed)
        share, kind = random.uniform(self.shallowest, 1.0), random.choice(TOUCH_MOTIONS)
        place = self._place(self._node(seed, self.reachable, random), share)
        aside = np.cross(place.normal, random.standard_normal(3))
        aside *= self.slide / np.linalg.norm(aside)
        for _ in range(MAX_HALVINGS):
            if self._free_slide(place, place._replace(touch=place.touch + aside)):
                break
            aside = 0.5 * aside
        length = float(np.linalg.norm(aside))
        speed = {"draw": DRAW_SPEED, "flick": FLICK_SPEED}.get(kind, 0.0)
        rise = RELEASE_SPEED if kind == "release" else 0.0

        def motion(time: float) -> Floats:
            later = max(time - NEXT_MOTION, 0.0)
            height = (TOUCH_CLEARANCE * self.radius + place.depth) * np.exp(-time / TOUCH_TIME) - place.depth
            gone = min(speed * later / length, 1.0) if length else 0.0
            return np.asarray(place.touch + (height + rise * later) * place.normal + gone * aside)

        return (Contact(Sphere(self.radius), motion, friction=self.friction),), TOUCH_SECONDS

    def grasp(self, seed: int, phases: Sequence[float] = PHASE_TIMES) -> tuple[tuple[Grasp], float]:
        """Return the load of forceps that pull, turn, return and release at some times [s], and its duration [s]."""
        random = np.random.default_rng(seed)
        size = random.uniform(self.shallowest, 1.0) * self.depth
        node = self._node(seed, self.graspable, random)
        place, normal = self.surface.points[node], self.normals[node]
        pull = size * _draw_in_cone(random, normal, MAX_PULL_ANGLE)
        turn = random.choice([0.0, 1.0]) * random.uniform(0.0, MAX_TURN) * _draw_in_cone(random, normal, np.pi)
        for _ in range(MAX_HALVINGS):
            if self._outside(place + np.linspace(0.25, 1.0, 4)[:, None] * pull).all():
                break
            pull = 0.5 * pull
        still = np.zeros(6)
        pulled, turned = np.concatenate([pull, still[3:]]), np.concatenate([pull, turn])
        path = PchipInterpolator(phases, [still, still, pulled, turned, still, still])

        def motion(time: float) -> tuple[Floats, Floats]:
            moved = path(np.clip(time, phases[0], phases[-1]))
            return place + moved[:3], moved[3:]

        return (Grasp(place, self.grasp_radius, motion, until=phases[-2]),), phases[-1]

    def pair(self, seed: int) -> tuple[tuple[Load, ...], float]:
        """Return the loads of a path and of a second one that begins up to 0.15 s later, and their duration [s].

        The second path is at a random place. In half of the pairs it is the nearest of some. The tools are never
        closer to each other than their radii and a spacing; without room for that the first one is alone. The
        second name ends in `SECOND_SUFFIX`.
        """
        first, duration = self._draw(seed)
        random = np.random.default_rng([seed, 2])
        delay = DELAY_STEP * random.integers(round(MAX_DELAY / DELAY_STEP) + 1)
        near = random.uniform() < NEAR_PAIRS
        seeds = seed - seed % CAMPAIGN_SEEDS + random.integers(SPREAD_PLACES, CAMPAIGN_SEEDS, PAIR_CANDIDATES)
        times = np.linspace(0.0, duration + delay, PAIR_SAMPLES)
        least, chosen = np.inf, None
        for number in seeds.tolist():
            second = _delayed(self._draw(number, is_touch(seed))[0], delay)
            distances = np.linalg.norm(_centres(first, times) - _centres(second, times), axis=1)
            apart = _size(first) + _size(second) + self.surface.cloud.spacing
            if distances.min() >= apart and (chosen is None or (near and distances.min() < least)):
                least, chosen = float(distances.min()), second
        if chosen is None:
            return (*self.others, first), duration
        return (*self.others, first, chosen), duration + delay

    def _draw(self, seed: int, touch: bool | None = None) -> tuple[Contact | Grasp, float]:
        """Return the press, the touch or the grasp of a path and its duration [s]."""
        touch = is_touch(seed) if touch is None else touch
        if _is_grasp(seed, self.grasps):
            (grasp,), duration = self.grasp(seed, TOUCH_PHASES if touch else PHASE_TIMES)
            return grasp, TOUCH_SECONDS if touch else duration
        (ball,), duration = self.touch(seed) if touch else self.press(seed)
        return ball, duration

    def _node(self, seed: int, allowed: NDArray[np.bool_], random: np.random.Generator) -> int:
        """Return the surface node of a path: a spread one for training, else one at random by area."""
        campaign, number = divmod(integer_in_range("seed", seed, 0), CAMPAIGN_SEEDS)
        if number < SPREAD_PLACES:
            node = int(self._order(campaign)[number])
            if allowed[node]:  # not where a press is asked for by the number of a grasp, or the reverse
                return node
        return int(_draw_by_area(random, np.where(allowed, self.surface.areas, 0.0), 1)[0])

    def _order(self, campaign: int) -> Ints:
        """Return the surface nodes of the first paths of a campaign, each far from those before it."""
        if campaign not in self._orders:
            random, points = np.random.default_rng([campaign, TRAINING_SEEDS]), self.surface.points
            nearest = np.full(len(points), np.inf)
            order = np.zeros(SPREAD_PLACES, dtype=np.int64)
            for k in range(SPREAD_PLACES):
                allowed = self.graspable if _is_grasp(k, self.grasps) else self.reachable
                drawn = _draw_by_area(random, np.where(allowed, self.surface.areas, 0.0), CANDIDATES_PER_PLACE)
                order[k] = drawn[np.argmax(nearest[drawn])]
                nearest = np.minimum(nearest, np.linalg.norm(points - points[order[k]], axis=1))
            self._orders[campaign] = order
        return self._orders[campaign]

    def _place(self, node: int, share: float) -> _Place:
        normal = self.normals[node]
        return _Place(self.surface.points[node] + self.heights[node] * normal, normal, share * self.depths[node])

    def _slide_end(self, first: int, start: _Place, share: float, slide: Floats) -> _Place:
        """Return the end of a slide, shortened until nothing obstructs it."""
        nodes = np.flatnonzero(self.reachable)
        for _ in range(MAX_HALVINGS):
            last = nodes[self._reachable_tree.query(self.surface.points[first] + slide)[1]]
            end = self._place(int(last), share)
            if start.normal @ end.normal > MIN_FACING and self._free_slide(start, end):
                return end
            slide = 0.5 * slide
        return start

    def _free_slide(self, start: _Place, end: _Place) -> bool:
        """Return whether the ball, lifted by its depth, touches nothing on a slide, and keeps from supports."""
        shares = np.linspace(0.0, 1.0, SLIDE_SAMPLES)
        centres, normals = _between(start, end, shares)
        depths = start.depth + shares * (end.depth - start.depth)
        gaps = self._samples.query(centres)[0] - self.radius
        below = self.surface.tree.query(centres - self.radius * normals)[1]
        fixed = self._to_fixed(self.surface.points[below])
        deepest = np.where(self.reachable[below], self.depths[below], np.inf)  # where the ball is off the body
        return bool(
            np.all(gaps >= -MAX_SAG * depths - TOUCH_RADII * self.radius)
            and np.all(fixed >= self.radius)
            and np.all(depths <= (1 + MAX_SAG) * deepest)
        )

    def _trace(self) -> Floats:
        """Return the height of the ball's centre above each node where it first touches the body; infinite if never."""
        surface, height = self.surface, np.full(len(self.surface.nodes), np.inf)
        begin = (1 + 2 * CLEARANCE_RADII) * self.radius
        centres = surface.points + begin * self.normals
        free = np.flatnonzero(
            (self._samples.query(centres)[0] >= self.radius) & self._connected(centres) & ~surface.held
        )
        height[free], moving = begin, free
        for _ in range(MAX_TRACES):
            centres = surface.points[moving] + height[moving, None] * self.normals[moving]
            gap = self._samples.query(centres)[0] - self.radius
            height[moving] -= np.maximum(gap, 0.0)
            moving = moving[gap > TOUCH_RADII * self.radius]
            if not len(moving):
                break
        return height

    def _connected(self, centres: Floats) -> NDArray[np.bool_]:
        """Return which places of the ball's centre are connected to the outside by a path as wide as the ball."""
        step = CELL_RADII * self.radius
        low, high = (edge(self.surface.points, axis=0) for edge in (np.min, np.max))
        low = low - 2 * self.radius
        cells = np.ceil((high + 2 * self.radius - low) / step).astype(int) + 1
        grid = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), axis=-1)
        # some place of a free cell is far enough from the body; the body's own surface is always blocked
        enough = self.radius - 0.5 * np.sqrt(3) * step
        blocked = np.isfinite(self._samples.query(low + step * grid.reshape(-1, 3), distance_upper_bound=enough)[0])
        parts = ndimage.label(~blocked.reshape(cells))[0]
        index = np.clip(np.rint((centres - low) / step).astype(int), 0, cells - 1)
        return np.asarray(parts[tuple(index.T)] == parts[0, 0, 0])

    def _thickness(self, nodes: NDArray[np.bool_]) -> Floats:
        """Return the depth [m] of the body below some nodes along the normal, down to fixed nodes.

        It is exact within half a spacing, and cut off where it no longer limits the depth. Fixed nodes count within
        half a radius of the line.
        """
        surface, step = self.surface, 0.5 * self.surface.cloud.spacing
        points, normals = surface.points[nodes], self.normals[nodes]
        thickness, inside = np.zeros(len(points)), np.arange(len(points))
        while len(inside):
            places = points[inside] - (thickness[inside] + step)[:, None] * normals[inside]
            on = ~self._outside(places)
            inside, places = inside[on], places[on]
            thickness[inside] += step
            if self._fixed is not None:
                distances, nearest = self._fixed.query(places)
                fixed = distances < 0.5 * self.radius
                below = np.einsum("ka,ka->k", places - surface.fixed_points[nearest], normals[inside])
                thickness[inside[fixed]] += np.maximum(below[fixed], 0.0)
                inside = inside[~fixed]
            inside = inside[MAX_DEPTH_RATIO * thickness[inside] < self.depth]
        return np.maximum(thickness, step)

    def _outside(self, places: Floats) -> NDArray[np.bool_]:
        """Return which places (k, 3) are outside the body, by the nearest surface node."""
        nearest = self.surface.tree.query(places)[1]
        return np.einsum("ka,ka->k", places - self.surface.points[nearest], self.surface.normals[nearest]) > 0

    def _to_fixed(self, places: Floats) -> Floats:
        """Return the distance [m] of each place (k, 3) to the nearest fixed node; infinite if there are none."""
        return np.full(len(places), np.inf) if self._fixed is None else np.asarray(self._fixed.query(places)[0])

    def _check_reach(self, reached: NDArray[np.bool_], distances: Floats) -> None:
        """Raise `InputError` where presses or grasps have no place."""
        surface, radius = self.surface, self.radius
        if not self.reachable.any():
            if surface.held.all():
                raise InputError("body must have a free surface, got supports at all surface nodes; support fewer")
            if not (reached & ~surface.held).any():
                raise InputError(f"radius must let a ball reach the body, got {radius:g} m; use a smaller one")
            largest = float(distances[reached & ~surface.held].max())
            raise InputError(
                f"radius must be at most {largest:.3g} m, the largest distance from supports, got {radius:g} m; use a "
                "smaller ball or support less"
            )
        if self.grasps and not self.graspable.any():
            raise InputError(
                f"radius must leave room for forceps of radius {self.grasp_radius:g} m away from supports, got "
                f"{radius:g} m; use a smaller ball, support less, or set grasps to 0"
            )


def is_touch(seed: int) -> bool:
    """Return whether a path is held out, and so a touch of a hand."""
    return seed % CAMPAIGN_SEEDS >= TRAINING_SEEDS


def _is_grasp(seed: int, grasps: float) -> bool:
    """Return whether a path is a grasp: the number of grasps up to a path is the share of all, rounded down."""
    return int((seed + 1) * grasps) > int(seed * grasps)


def _is_pair(number: int, pairs: float) -> bool:
    """Return whether a held-out path has two tools: a share of any first ones, independent of which are grasps."""
    return bool((number + 1) * GOLDEN_RATIO % 1.0 < pairs)


def _delayed(load: Contact | Grasp, delay: float) -> Contact | Grasp:
    """Return a second tool that moves some time [s] later; forceps hold from the start on."""
    motion: Any = load.motion
    later: dict[str, Any] = {"name": load.name + SECOND_SUFFIX, "motion": lambda time: motion(time - delay)}
    if isinstance(load, Grasp):
        later["until"] = load.until + delay
    return replace(load, **later)


def _centres(load: Contact | Grasp, times: Floats) -> Floats:
    """Return the positions (k, 3) [m] of a tool at some times [s]."""
    motion: Any = load.motion
    return np.array([motion(time)[0] if isinstance(load, Grasp) else motion(time) for time in times.tolist()])


def _size(load: Contact | Grasp) -> float:
    """Return the radius [m] of a ball or of forceps."""
    if isinstance(load, Grasp):
        return float(load.radius)
    assert isinstance(load.tool, Sphere)
    return float(load.tool.radius)


def _between(start: _Place, end: _Place, shares: Floats) -> tuple[Floats, Floats]:
    """Return the touching centres (k, 3) [m] and normals (k, 3) between two places."""
    shares = shares[:, None]
    normals = (1 - shares) * start.normal + shares * end.normal
    return (1 - shares) * start.touch + shares * end.touch, normals / np.linalg.norm(normals, axis=1)[:, None]


def _centroids(surface: FreeSurface) -> Floats:
    triangles = surface.cloud.triangles
    return np.asarray(surface.cloud.points[triangles].mean(axis=1)) if len(triangles) else np.zeros((0, 3))


def _draw_by_area(random: np.random.Generator, areas: Floats, count: int) -> Ints:
    """Return nodes at random, with probabilities in proportion to their areas (s,)."""
    total = np.cumsum(areas)
    return np.searchsorted(total, random.uniform(0.0, total[-1], count), side="right")


def _draw_in_cone(random: np.random.Generator, axis: Floats, angle: float) -> Floats:
    """Return a random unit vector (3,) within an angle [rad] of an axis."""
    along = random.uniform(np.cos(angle), 1.0)
    across = np.cross(axis, random.standard_normal(3))
    return np.asarray(along * axis + np.sqrt(1.0 - along**2) * across / np.linalg.norm(across))
