"""A circular membrane pushed at its centre (section 6.2, Figures 6 to 9).

Its numbers stand in ``data/membrane.toml``, the taut sheet that a view and a training open. The paper's run has a sheet
without prestretch, and its own motion of the tool.
"""

from __future__ import annotations

from palpate.core.faults import InputError, brief, number_in_range
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.membrane.model import Membrane
from palpate.meshfree.sheets import disc
from palpate.scenes.load_case import LoadCase
from palpate.scenes.open_scene import open_scene

MEMBRANE_SCENE = open_scene("membrane")
RADIUS = MEMBRANE_SCENE.description.surface.disc_radius  # [m]
PUSH_SPEED, PUSH_TIME = 0.1, 0.1  # [m/s], [s]
DURATION, EVERY = 0.2, 0.002  # [s]
MIN_SPACING = 0.001  # [m] 36,000 nodes
AFTER = ("return", "hold", "release")


def tool_tip(time: float, after: str = "return") -> float:
    """Return the displacement [m] of the tool tip in equation (35) at a time [s].

    It rises at 0.1 m/s to 10 mm at 0.1 s. After that time it is 0 for ``"return"``, else unchanged.
    """
    if time <= PUSH_TIME * (1 + 1e-9):
        return PUSH_SPEED * max(time, 0.0)
    return 0.0 if after == "return" else PUSH_SPEED * PUSH_TIME


def membrane(
    spacing: float = 0.005,
    after: str = "return",
    tool_radius: float = 0.0,
    prestretch: float = 1.0,
    layout: str = "rings",
    jitter: float = 0.0,
    seed: int = 0,
    relaxed: bool = True,
) -> LoadCase:
    """Return the paper's membrane: a disc, 0.2 m across and 0.01 mm thick, its rim fixed, its centre pushed by a tool.

    Neo-Hookean with C1 = 0.17 MPa, density 1200 kg/m^3. The tool's group is ``"tool"``. A snapshot is kept every 2 ms
    for 0.2 s; that at 0.1 s shows the sheet just before the tool returns or releases it.

    The spacing is at least 1 mm. After 0.1 s the tool may ``"return"`` to 0 at once, as in (35), ``"hold"`` or
    ``"release"``. Nodes within `tool_radius` [m], at least the spacing, follow the tool; 0 is the paper's point, the
    node at the centre. The rest is as for `palpate.disc` and `palpate.Membrane`.
    """
    spacing = number_in_range("spacing", spacing, MIN_SPACING, unit="m")
    tool_radius = number_in_range("tool_radius", tool_radius, 0.0, 0.8 * RADIUS, unit="m")
    if after not in AFTER:
        raise InputError(f"after must be one of {', '.join(map(repr, AFTER))}, got {brief(after)}")
    cloud = disc(RADIUS, spacing, layout, jitter, seed)
    cloud = cloud.within("tool", (0.0, 0.0), max(tool_radius, 1e-6 * spacing), margin=0.0)
    if tool_radius > 0 and len(cloud.group("tool")) == 1:
        raise InputError(
            f"tool_radius must hold more nodes than the centre, got {tool_radius:g} m; use at least about the spacing, "
            f"{cloud.spacing:g} m, or 0 for the paper's point"
        )
    thickness = MEMBRANE_SCENE.description.body.thickness
    assert thickness is not None  # the scene gives it
    material = MEMBRANE_SCENE.material
    model = Membrane(cloud, material, thickness, "rim", prestretch=prestretch, relaxed=relaxed)
    until = PUSH_TIME if after == "release" else float("inf")
    tool = PrescribedMotion("tool", lambda points, time: (0.0, 0.0, tool_tip(time, after)), until)
    parameters: dict[str, float | str] = {
        "spacing": spacing,
        "tool_radius": tool_radius,
        "prestretch": model.prestretch,
        "jitter": float(jitter),
        "seed": seed,
        "after": after,
        "layout": layout,
    }
    return LoadCase(model, (tool,), DURATION, EVERY, f"Membrane under a tool tip, then {after}", parameters)
