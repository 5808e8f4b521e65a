"""What the page computes without a browser: the force in words, the end of the colour scale, and the colours."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import palpate as pt
from palpate.app.device.statistics import tool_name
from palpate.app.view.server.frames import STATE_NUMBERS, TOOL_NUMBERS, cut_geometry_frame
from palpate.dynamics.contact.blade import Scalpel
from palpate.realtime.bodies.display_surface import NO_CUT_LINE, CutLine

sys.path.append(str(Path(__file__).parent))

from synthetic_session import sphere

SOURCES = Path(pt.__file__).parents[2] / "page" / "src"
NODE = shutil.which("node")

pytestmark = pytest.mark.skipif(
    NODE is None or not SOURCES.is_dir(), reason="needs Node and the page's sources; on Debian: apt-get install nodejs"
)


def evaluate(module: str, expression: str) -> Any:
    """Return the value of a JavaScript expression in which `m` is a module of the page."""
    code = f"import * as m from {json.dumps((SOURCES / module).as_uri())}; console.log(JSON.stringify({expression}));"
    command = [str(NODE), "--input-type=module", "--eval", code]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.parametrize(("name", "fields"), [("STATE_FIELDS", STATE_NUMBERS), ("TOOL_FIELDS", TOOL_NUMBERS)])
def test_the_page_reads_the_fields_that_the_server_sends(name, fields):
    sizes = [[field, int(np.prod(fields[field].shape, dtype=int))] for field in fields.names]
    assert evaluate("protocol.js", f"Object.entries(m.{name})") == sizes


@pytest.mark.parametrize(
    ("newtons", "bound", "value", "between"),
    [
        (0.57, 0.091, "0.6", "0.5 to 0.7"),
        (1.44, 0.84, "1.5", "0.5 to 2.5"),
        (12.34, 0.02, "12.34", "12.32 to 12.36"),
        (34.0, 7.0, "35", "25 to 40"),
    ],
)
def test_a_force_has_the_digits_that_its_bound_supports(newtons, bound, value, between):
    reading = evaluate("forceText.js", f"m.boundedForce({newtons}, {bound})")
    assert reading == {"lead": "about", "value": value, "range": between}


@pytest.mark.parametrize(
    ("nodes_error", "between", "note"),
    [
        ("null", "0.3 to 0.5", "Without the error of the nodes, which is not known."),
        ("0.25", "0.2 to 0.6", "With the error of the nodes."),
    ],
)
def test_the_range_of_a_force_has_the_error_of_the_nodes_or_says_that_it_is_not_known(nodes_error, between, note):
    state = f"newtons: 0.4, bound: 0.1, calibrated: true, nodesError: {nodes_error}"
    reading = evaluate("forceText.js", f"m.forceReading({{{state}}})")
    assert reading == {"lead": "about", "value": "0.4", "range": between, "note": note}


@pytest.mark.parametrize(("trained", "speeds"), [("0.1", [0.1, 0.5, 0.1]), ("null", [0.5, 0.5, 0.5])])
def test_an_exported_tool_is_faster_than_in_training_only_if_the_user_asks(trained, speeds):
    fields = f"about: {{ tool_speed: {trained}, max_tool_speed: 0.5 }}, arrays: {{ options: [0, 0, 0] }}, replay: null"
    tools = "tools: [{ describe: () => ({}) }], post: ({ fast }) => found.push([fast, session.arrays.options[2]])"
    session = (
        f"Object.assign(Object.create(m.LocalSession.prototype), {{ {fields}, frames: null, modulus: 1, {tools} }})"
    )
    code = f"""(() => {{
        const found = [], session = {session};
        session.about.materials = [];
        for (const fast of [false, true, false]) session.handle({{ type: "follow", fast }});
        return found;
    }})()"""
    limited = trained != "null"
    assert evaluate("localSession.js", code) == [
        [fast and limited, speed] for fast, speed in zip((False, True, False), speeds, strict=True)
    ]


@pytest.mark.parametrize(
    ("state", "text"),
    [
        ("trust: 0.6, beyond: false, bound: 0.1", "Within training"),
        ("trust: 1.3, beyond: false, bound: 0.1", "Slightly beyond training"),
        ("trust: 0.6, beyond: false, bound: null", "After a motion beyond training"),
        ("trust: 2.5, beyond: true, bound: null", "Beyond training"),
    ],
)
def test_details_do_not_call_a_force_without_bound_trained(state, text):
    assert evaluate("forceText.js", f"m.trustText({{{state}}}).text") == text


def test_a_force_that_rounds_to_nothing_is_under_its_largest_value():
    reading = evaluate("forceText.js", "m.boundedForce(0.03, 0.12)")
    assert reading == {"lead": "under", "value": "0.2", "range": ""}


def test_rounding_leaves_most_of_the_bound():
    cases = [(float(f), float(b)) for f in np.linspace(0, 9, 61) for b in np.geomspace(0.004, 3, 41)]
    found = evaluate("forceText.js", f"{json.dumps(cases)}.map(([f, b]) => m.boundedForce(f, b))")
    for (newtons, bound), reading in zip(cases, found, strict=True):
        between = reading["range"] if reading["lead"] == "about" else f"0 to {reading['value']}"
        low, high = (float(part) for part in between.split(" to "))
        assert low <= max(newtons - 0.7 * bound, 0) + 1e-9
        assert high >= newtons + 0.7 * bound - 1e-9


@pytest.mark.parametrize(
    ("state", "value", "note"),
    [
        ("newtons: 0.574, full: true, calibrated: false", "0.57", "Full model: no error of reduction."),
        ("newtons: 12.4, full: true, calibrated: false", "12", "Full model: no error of reduction."),
        ("newtons: 0, bound: 0.1, calibrated: true", "0", ""),
        ("newtons: 3.44, bound: undefined, calibrated: true", "3.4", ""),
        ("newtons: 0.5, bound: null, calibrated: true", "0.50", "Its error is not known"),
        ("newtons: 0.5, bound: null, calibrated: false", "0.50", "The error of this model was not measured."),
        ("newtons: 0, full: true, through: true", "", "The tool slipped through the surface"),
        ("newtons: 9.5, bound: 0.1, calibrated: true, beyond: true", "", "Beyond what the model was trained on"),
    ],
)
def test_a_force_without_a_bound_states_why(state, value, note):
    reading = evaluate("forceText.js", f"m.forceReading({{ {state} }})")
    assert reading["value"] == value
    assert reading["note"].startswith(note)
    assert reading["note"] or not note
    assert reading["lead"] == ""
    assert reading["range"] == ""


def test_the_limit_of_training_has_hysteresis():
    trusts = [0.99, 1.01, 0.97, 0.93, 0.91, 0.97]
    code = f"{trusts}.reduce((seen, trust) => [...seen, m.isBeyond(trust, seen.at(-1) ?? false)], [])"
    assert evaluate("forceText.js", code) == [False, True, True, True, False, False]


def test_two_forces_are_compared_in_newtons_and_percent():
    assert evaluate("forceText.js", "m.comparisonText(0.61, 0.58)") == "reduced 0.61 N, full 0.58 N: 0.03 N more (5 %)"
    assert evaluate("forceText.js", "m.comparisonText(0.5, 0.58)").endswith("0.08 N less (14 %)")
    assert evaluate("forceText.js", "m.comparisonText(0.01, 0)") == "reduced 0.01 N, full 0.00 N: 0.01 N more"


def test_a_pace_is_shown_below_real_time_only():
    assert evaluate("forceText.js", "[1, 0.96, 0.62, 0.043].map(m.paceText)") == [
        "", "", "0.6 of real time", "0.04 of real time"
    ]  # fmt: skip


def scale(percentiles, seconds=0.05, least=1.0):
    """Return the rounded ends and the ends that colours use, after each percentile."""
    code = (
        f"(s => {json.dumps([float(p) for p in percentiles])}.map(p => {{ const shown = s.update(p, {seconds});"
        f" return [s.end, shown]; }}))(new m.ColourScale({least}))"
    )
    return np.array(evaluate("colourScale.js", code)).T


def test_the_scale_ends_at_rounded_numbers_that_hold_the_percentile():
    for percentile, end in ((0.0, 1), (1.4, 2), (3.0, 5), (7.7, 10), (130.0, 200)):
        ends, shown = scale([percentile] * 100)
        assert ends[-1] == end
        assert shown[-1] == pytest.approx(end, rel=0.01)


def test_the_scale_does_not_follow_a_percentile_that_wavers_about_an_end():
    wavering = 5 + 0.4 * np.sin(np.arange(2000))
    ends, _ = scale([*[4.0] * 40, *wavering])
    assert np.count_nonzero(np.diff(ends[40:])) <= 1


def test_the_scale_shrinks_slowly_and_step_by_step():
    ends, _ = scale([*[9.0] * 60, *[0.0] * 1200])
    assert ends[59] == 10
    assert (ends[60 : 60 + 60] == 10).all()  # for 3 s
    assert sorted(set(ends[60:].tolist())) == [1, 2, 5, 10]
    assert (np.diff(ends[60:]) <= 0).all()


def test_the_colours_glide_to_a_new_end():
    _, shown = scale([*[0.5] * 20, *[90.0] * 100], seconds=1 / 60)
    assert (shown[1:] / shown[:-1]).max() < 1.8
    assert shown[-1] == pytest.approx(100, rel=0.01)


def lightness(colour):
    """Return CIE L* of an sRGB colour."""
    part = np.asarray(colour)
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    return 116 * np.cbrt(luminance) - 16


def test_zero_is_tissue_and_both_signs_grow_lighter():
    shares = np.linspace(-1, 1, 41)
    colours = np.array(evaluate("colours.js", f"{shares.tolist()}.map(m.colourAt)"))
    red, green, blue = colours[20]
    assert red > 2.5 * max(green, blue)
    found = lightness(colours)
    assert (np.diff(found[20:]) > 1).all()
    assert (np.diff(found[:21]) < -0.3).all()
    # blue against yellow, which people with red-green blindness tell apart
    assert (colours[:8, 2] > colours[:8, 0] + 0.1).all()
    assert (colours[33:, 0] > colours[33:, 2] + 0.15).all()


def test_the_legend_begins_at_zero_or_at_minus_its_end():
    colour = "rgb({} {} {})"
    zero, low = evaluate("colours.js", "[0, -1].map(t => m.colourAt(t).map(part => Math.round(255 * part)))")
    assert evaluate("colours.js", "m.gradient(false)").startswith(f"linear-gradient(to right, {colour.format(*zero)},")
    signed = evaluate("colours.js", "m.gradient(true)")
    assert signed.startswith(f"linear-gradient(to right, {colour.format(*low)},")
    assert colour.format(*zero) in signed


@pytest.mark.parametrize(
    ("space", "right", "letters"),
    [
        ("LPS", [1, 0, 0], ["R", "L"]),  # from the front
        ("LPS", [-1, 0, 0], ["L", "R"]),  # from the rear
        ("LPS", [0, 1, 0], ["A", "P"]),  # from the left
        ("LPS", [0.95, 0.31, 0], ["R", "L"]),  # the first view
        ("LPS", [0.8, -0.6, 0], ["RP", "LA"]),
        ("RAS", [1, 0, 0], ["L", "R"]),
        ("RAS", [0, 1, 0], ["P", "A"]),
        ("", [1, 0, 0], None),
    ],
)
def test_letters_at_the_scale_bar_are_the_sides_of_the_patient(space, right, letters):
    assert evaluate("sides.js", f"m.sideLetters({json.dumps(space)}, {right})") == letters


def test_letters_have_words():
    assert evaluate("sides.js", "['R', 'LA'].map(m.sideWords)") == ["right", "left, front"]


def test_labels_are_found_by_words_of_their_names_and_by_their_numbers():
    labels = [{"name": "kidney_left", "number": 3}, {"name": "rib_left_3", "number": 94}]
    for text, found in (("", [0, 1]), ("left", [0, 1]), ("LEFT kid", [0]), ("kidney_l", [0]), ("94", [1]), ("x", [])):
        expression = f"{json.dumps(labels)}.map((each) => m.matches(each, {json.dumps(text)}))"
        assert [k for k, match in enumerate(evaluate("labelChoice.js", expression)) if match] == found


def test_volumes_have_the_digits_that_one_compares():
    volumes = [1.1257e-3, 1.374e-4, 1.88e-5, 4.5e-6, 2e-8]
    texts = evaluate("labelChoice.js", f"{volumes}.map(m.millilitres)")
    assert texts == ["1126", "137", "19", "4.5", "0.02"]


def test_a_frame_of_shapes_is_decoded():
    names, kinds, edges = ["Niere «links»", "rib"], ["organ", "bone"], [[[0.0, 0.0, 0.1], [0.0, 0.0, -1.0]]]
    points = np.arange(21, dtype="<f4")
    triangles = np.array([0, 1, 2, 3, 4, 5, 4, 5, 6], dtype="<u4")
    sizes = np.array([1, 2], dtype="<u4")
    head = np.array([7, 2, 7, 3], dtype="<u4")
    frame = b"".join(part.tobytes() for part in (head, points, triangles, sizes))
    frame += json.dumps({"names": names, "kinds": kinds, "edges": edges}).encode()
    expression = (
        "(({ positions, triangles, sizes, names, kinds, edges }) => "
        "[[...positions], [...triangles], [...sizes], names, kinds, edges])"
        f"(m.decode(new Uint8Array({list(frame)}).buffer))"
    )
    found = evaluate("protocol.js", expression)
    assert found == [points.tolist(), triangles.tolist(), sizes.tolist(), names, kinds, edges]


def test_the_drawn_edge_is_that_of_the_session():
    edge = np.array(evaluate("bladeEdge.js", "m.cuttingEdge(0.03, 12)"))
    of_session = Scalpel(length=0.03, toughness=5.0).edge
    np.testing.assert_allclose(edge, of_session[:, [0, 2]], atol=1e-12)
    assert edge[:, 1].min() == edge[6, 1] == 0.0  # the position is the deepest point


def test_a_stroke_is_at_most_as_deep_as_the_edge_cuts():
    height = Scalpel(length=0.03, toughness=5.0).edge[0, 2]
    deepest = evaluate("bladeEdge.js", "m.deepestStroke(0.03)")
    assert 0.8 * height < deepest < height
    tools = '[{ kind: "scalpel", length: 0.03, depth: 0.02 }, { kind: "scalpel", length: 0.03, depth: 0.004 }]'
    depths = evaluate("toolSettings.js", f"{tools}.map((tool) => m.withinEdge(tool).depth)")
    assert depths == [pytest.approx(deepest), 0.004]
    assert evaluate("toolSettings.js", 'm.withinEdge({ kind: "sphere", radius: 0.01 })') == {
        "kind": "sphere", "radius": 0.01,
    }  # fmt: skip


def test_a_frame_of_a_cut_is_decoded_with_its_line():
    points, triangles = np.arange(15.0).reshape(5, 3), np.array([[0, 1, 2], [0, 2, 3], [2, 3, 4]])
    line = CutLine(np.array([[0, 2, 3]], dtype=np.uint32), np.array([[0.25, 0.5, 0.0, 1.0]], dtype=np.float32))
    surface = SimpleNamespace(rest=points, triangles=triangles, fixed=np.array([1, 0, 0, 0, 1]), cut_line=line)
    shown = "[g.kind, [...g.positions], [...g.triangles], [...g.fixed], [...g.line.corners], [...g.line.ends]]"
    for frame, ends in (
        (cut_geometry_frame(surface), line.ends.ravel().tolist()),
        (cut_geometry_frame(SimpleNamespace(**vars(surface) | {"cut_line": NO_CUT_LINE})), []),
    ):
        found = evaluate("protocol.js", f"((g) => {shown})(m.decode(new Uint8Array({list(frame)}).buffer))")
        assert found[:2] == [6, points.ravel().tolist()]
        assert found[2:4] == [triangles.ravel().tolist(), [1, 0, 0, 0, 1]]
        assert found[4:] == [[0, 2, 3] if ends else [], ends]


@pytest.mark.parametrize(
    ("statistics", "text"),
    [
        ("{}", ""),
        ("{ cutting_force: 0 }", ""),
        (
            "{ cut_area: 1.82e-4, cut_length: 0.0341, cut_depth: 0.0064 }",
            "Cut: 182 mm², 34 mm long, 6.4 mm deep.",
        ),
        (
            "{ cut_area: 4.2e-6, cut_length: 0.0031, cut_depth: 0.0009, cutting_force: 0.61 }",
            "Cut: 4.2 mm², 3.1 mm long, 0.9 mm deep. The blade cuts at 0.61 N; below that the tissue moves with it.",
        ),
        ("{ cutting_force: 0.61 }", "The blade cuts at 0.61 N; below that the tissue moves with it."),
        (
            "{ cutting_force: 0, tears: true }",
            "The tissue here is so taut that it would tear by itself: the blade needs no force.",
        ),
    ],
)
def test_the_size_of_a_cut_is_stated_with_and_without_a_scalpel(statistics, text):
    assert evaluate("forceText.js", f"m.cutText({statistics})") == text


def test_a_frame_of_all_tools_is_decoded():
    rows = [
        [5, 1, 0.3, 0.0, 0.4, 1, 2, 3, 0.01, 0.02, 0.03, 1, 0, 0, 0, 41],
        [3, 0, 0, 0, 2, 4, 5, 6, 0.04, 0.05, 0.06, 0, 1, 0, 0, 42],
    ]
    frame = np.array([8, 7, 2, 0], dtype="<u4").tobytes() + np.array(rows, dtype="<f8").tobytes()
    told = "[t.kind, t.pinned, t.newtons, [...t.position], [...t.quaternion], t.pose]"
    expression = (
        f"(({{ sequence, tools }}) => [sequence, ...tools.map((t) => {told})])"
        f"(m.decode(new Uint8Array({list(frame)}).buffer))"
    )
    sequence, first, second = evaluate("protocol.js", expression)
    assert sequence == 7
    assert first == ["scalpel", True, pytest.approx(0.5), [0.01, 0.02, 0.03], [1, 0, 0, 0], 41]
    assert second == ["grasp", False, 2, [0.04, 0.05, 0.06], [0, 1, 0, 0], 42]


def _ball_with_a_wound():
    """Vertices and triangles of a ball of 5 cm with a slit of two walls at its top."""
    vertices, triangles = sphere(24, 48)
    deep, top = 0.04, 0.0499
    corners = [[x, y, z] for y in (1e-4, -1e-4) for x in (-0.01, 0.01) for z in (deep, top)]
    a = len(vertices)
    walls = [[a, a + 1, a + 2], [a + 1, a + 3, a + 2], [a + 4, a + 6, a + 5], [a + 5, a + 6, a + 7]]
    return np.vstack([vertices, corners]), np.vstack([triangles, walls])


@pytest.mark.parametrize("surface", [sphere(24, 48), _ball_with_a_wound()], ids=["whole", "cut"])
def test_a_blade_follows_the_surface_at_rest_and_not_its_wound(surface):
    vertices, triangles = surface
    build = f"new m.RestSurface({np.ravel(vertices).round(6).tolist()}, {np.ravel(triangles).tolist()})"
    places = [[0.05 * np.sin(a), 0.0, 0.05 * np.cos(a)] for a in (0.0, 0.2, 0.5)]
    asked = f"(s => {json.dumps(places)}.map((p) => s.around(p, p.map((x) => 20 * x), 0.015)))({build})"
    found = evaluate("restSurface.js", asked)
    for place, each in zip(places, found, strict=True):
        assert np.dot(each["normal"], place) / 0.05 > 0.999
    heights = [each["height"] for each in found]
    assert np.ptp(heights) < 2e-4  # the same mean below each place of a ball
    assert -0.0015 < heights[0] < 0


@pytest.mark.parametrize(
    ("page", "socket"),
    [
        ("http://127.0.0.1:8765/#abc", "ws://127.0.0.1:8765/session"),
        ("http://localhost:9000/index.html?still#abc", "ws://localhost:9000/session"),
        ("https://lab.example.org/#abc", "wss://lab.example.org/session"),
        ("https://hub.example.org:8443/user/a%40b/proxy/8765/#abc", "wss://hub.example.org:8443/user/a%40b/proxy/8765/session"),
    ],
)  # fmt: skip
def test_the_socket_is_next_to_the_page_and_secure_where_the_page_is(page, socket):
    assert evaluate("protocol.js", f"m.socketAddress({json.dumps(page)})") == socket


def test_a_tool_has_the_name_of_the_terminal_and_of_reports():
    titles = evaluate("hands.js", "[0, 1, 3].map((index) => m.titleOf(index, 'grasp'))")
    assert titles == [f"{tool_name(index).capitalize()}: forceps" for index in (0, 1, 3)]


@pytest.mark.parametrize(
    ("newtons", "text"),
    [(0.0, "0"), (0.004, "0"), (0.0073, "0.01"), (0.0142, "0.014"), (0.0996, "0.10"), (0.15, "0.15"), (0.996, "1.0")],
)
def test_a_small_force_has_two_digits_from_ten_millinewtons_up(newtons, text):
    assert evaluate("forceText.js", f"m.plainForce({newtons})") == text


@pytest.mark.parametrize(
    ("depth", "newtons", "known", "reading"),
    [
        ("0.0063", 1.32, "true", ("6.3", "0.21")),
        ("0.018", 1.0, "true", ("18.0", "0.056")),
        ("0.002", 25.0, "true", ("2.0", "13")),  # steep: no decimals
        ("0.0063", 1.32, "false", ("6.3", "")),  # beyond training
        ("0.0063", 0.0, "true", ("6.3", "")),  # in the air
        ("0.00019", 0.3, "true", ("", "")),  # a quotient of small numbers says nothing
        ("null", 0.3, "true", ("", "")),  # forceps
    ],
)
def test_a_press_has_its_depth_and_its_force_over_depth(depth, newtons, known, reading):
    found = evaluate("forceText.js", f"m.pressReading({depth}, {newtons}, {known})")
    assert (found["depth"], found["stiffness"]) == reading


def test_a_click_presses_lightly_and_grows_evenly_to_its_full_depth():
    code = "((g) => Array.from({ length: 60 }, () => (g.update(1 / 60), [g.depth, g.over])))(new m.Growth(0.0063))"
    depths, over = (np.array(each) for each in zip(*evaluate("pressDepth.js", code), strict=True))
    assert 0.001 < depths[0] < 0.0011
    assert (np.diff(depths) >= 0).all()
    assert np.diff(depths).max() < 2 * 0.0053 / 48  # no jump
    assert depths[-1] == pytest.approx(0.0063)
    assert np.flatnonzero(over)[0] in (47, 48)  # 0.8 s
    assert evaluate("pressDepth.js", "new m.Growth(0.0004).light") == 0.0004  # a small ball: no deeper than a click


def test_a_drag_down_or_up_takes_the_depth_of_a_click_over():
    over = "(g => (ways.forEach((y) => g.drag(y)), g.over))(new m.Growth(0.006))"
    code = f"[[3, 1], [3, -3], [5], [-2, -3]].map((ways) => {over})"
    assert evaluate("pressDepth.js", code) == [False, False, True, True]


def test_the_depth_of_a_tool_is_along_the_normal_only():
    assert evaluate("pressDepth.js", "m.depthAt([0.1, 0, 0.05], [0, 0, 1], [0.13, 0.02, 0.047])") == pytest.approx(
        0.003
    )


def test_the_curve_of_a_press_is_kept_until_the_next_one():
    steps = "[['a', 0, 0], ['a', 0.001, 0.2], ['a', 0.001, 0.2], ['a', 0.002, null], ['a', 0.001, 0.1]]"
    shown = "[[...c.depths], [...c.forces]]"
    code = (
        f"((c) => {{ for (const each of {steps}) c.add(...each); const first = {shown}; c.add('b', 0.004, 1);"
        f" const second = {shown}; for (let k = 0; k < 9000; k++) c.add('b', 1e-4 * (k % 50), 1); return"
        f" [first, second, c.depths.length, c.forces.length]; }})(new m.PressCurve())"
    )
    first, second, *lengths = evaluate("pressCurve.js", code)
    assert first == [[0, 1, 2, 1], [0, 0.2, None, 0.1]]
    assert second == [[4], [1]]
    assert lengths[0] == lengths[1] <= 3000


def test_the_force_of_a_held_tool_is_read_where_none_is_in_hand():
    def read(in_hand, *tools):
        slots = [{"pinned": pinned, "state": {"kind": kind, "newtons": newtons}} for kind, pinned, newtons in tools]
        fields = json.dumps({"inHand": in_hand, "slots": slots})
        return evaluate("hands.js", f"Object.assign(Object.create(m.Hands.prototype), {fields}).read")

    away, forceps = ("none", False, 0.0), ("grasp", True, 0.15)
    assert read(0, away, away) == 0
    assert read(1, forceps, away) == 0
    assert read(2, forceps, ("sphere", True, 0.4), away) == 1  # the largest
    assert read(1, forceps, ("sphere", False, 0.0)) == 1  # in hand, though in the air
    assert read(1, ("grasp", True, 0.0), away) == 1


def test_messages_stand_below_a_title_that_they_would_cover():
    titles = [(200, 70), (250, 70), (730, 93), (20, 12)]
    tops = [
        evaluate("titleRoom.js", f"m.messagesTop({{ right: {right}, bottom: {bottom} }}, {{ left: 254 }}, 24)")
        for right, bottom in titles
    ]
    assert tops == [24, 82, 105, 24]


def test_a_hint_is_shown_for_a_tool_and_a_way_to_use_it_until_the_tool_was_used():
    kinds = ["sphere", "capsule", "grasp", "scalpel", "group", None]
    for way, word in (("mouse", "Hold on"), ("touch", "finger"), ("keys", "Arrow keys")):
        texts, after = (
            evaluate("toolHints.js", f"{json.dumps(kinds)}.map((kind) => m.hintText(kind, '{way}', {used}) ?? '')")
            for used in ("new Set()", "new Set(['press'])")
        )
        assert [word in text for text in texts] == [True] * 4 + [False] * 2
        assert texts[0] == texts[1]
        assert after == ["", "", texts[2], texts[3], texts[4], texts[5]]


def test_vertices_are_cut_off_where_they_lie_in_a_plane_and_face_outwards():
    rest, normals = [[0, 0, 0.1], [0, 0, 0.1], [0, 0, 0.1], [0, 0, 0.09]], [[0, 0, 1], [1, 0, 0], [0, 0, -1], [0, 0, 1]]
    flat = [np.ravel(each).tolist() for each in (rest, normals)]
    planes = [[[1.0, 2.0, 0.1005], [0.0, 0.0, -1.0]]]
    found = evaluate("bodyMesh.js", f"[...m.verticesInPlanes({flat[0]}, {flat[1]}, {planes}, 0.002)]")
    assert found == [1, 0, 0, 0]


def test_the_drawn_blade_is_narrow_behind_its_edge_and_tapers_to_its_point():
    edge = np.array(evaluate("bladeEdge.js", "m.cuttingEdge(0.03)"))
    ground = evaluate("bladeGlyph.js", "[...m.bladeParts(0.03).flat[0].attributes.position.array]")
    points = np.array(ground).reshape(-1, 3)
    blade = points[points[:, 2] < edge[-1, 1]]  # without the tang, which leads to the handle
    heights = np.linalg.norm(blade[:, None, ::2] - edge, axis=2).min(axis=1)
    assert 3.5e-3 < heights.max() < 6e-3
    behind = blade[:, 0] < -0.012
    assert heights[behind].max() < 0.6 * heights.max()


def test_the_motion_of_an_end_is_the_mean_of_its_vertices():
    body = "{ rest: [0, 0, 0, 1, 0, 0, 1, 1, 0], positions: [0, 0, 0, 1.3, 0, 0.1, 1.3, 1, 0.7] }"
    motion = evaluate("bodyEnd.js", f"m.endMotion([1, 2], {body})")
    assert motion["moved"] == pytest.approx(0.5)
    assert motion["place"] == pytest.approx([1.3, 0.5, 0.4])
    task = "Pull the end of the bar: "
    for call, text in (
        ("'Bar', false", f"{task}hold the button on its free end and drag."),
        ("'Bar', true", f"{task}forceps hold it, drag anywhere."),
        ("'Bar', true, ['Yeoh', 'Gent']", f"{task}forceps hold it, drag anywhere. Solid: Yeoh; lines: Gent."),
        ("'MRI bar', false", "Pull the end of the MRI bar: hold the button on its free end and drag."),
    ):
        assert evaluate("bodyEnd.js", f"m.taskText({call})") == text
    assert evaluate("bodyEnd.js", "m.forceOf([{ force: [1, 0, 2] }, { force: [2, 4, -2] }])") == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("hello", "has", "lacks"),
    [
        ("{ tools: ['sphere', 'scalpel'], max_tools: 4 }", {"press", "cut", "several", "choice"}, {"pull", "group"}),
        ("{ tools: ['sphere'], max_tools: 1 }", {"press", "depth"}, {"choice", "several", "fingers", "cut"}),
        ("{ tools: [], max_tools: 1 }", {"pull", "group", "live"}, {"press", "depth", "choice", "replay"}),
        ("{ mode: 'replay', tools: ['sphere'], max_tools: 4 }", {"replay"}, {"press", "live", "several", "choice"}),
    ],
)
def test_help_needs_what_the_session_has(hello, has, lacks):
    facts = evaluate("help.js", f"m.helpFacts({hello}, false)")
    assert {name for name, is_so in facts.items() if is_so} >= has
    assert not any(facts[name] for name in lacks)


@pytest.mark.parametrize(
    ("message", "text", "share"),
    [
        ("state: 'ready', note: ''", "", None),
        ("state: 'ready', note: 'The recording ended with the former body.'", "The recording ended", None),
        ("state: 'preparing', phase: '', seconds_left: null, fraction: null", "Starting …", None),
        ("state: 'preparing', phase: 'compiling', seconds_left: 40, fraction: 0.2", "Compiling: about 40 s left", 0.2),
        ("state: 'failed', note: 'no memory'", "This body could not be made: no memory", None),
    ],
)
def test_the_menu_of_the_body_shows_what_is_done(message, text, share):
    shown = evaluate("bodyMenu.js", f"m.menuProgress({{ {message} }})")
    assert shown["text"].startswith(text)
    assert shown.get("share") == share
