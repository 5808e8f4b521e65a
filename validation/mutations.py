"""Change one line of the sources after another, and see that the tests notice.

    python validation/mutations.py
    python validation/mutations.py --only "friction"

Each mutation is a mistake that a change could bring: a wrong derivative, a load that is dropped, a state that leaks.
It is made in a copy of the sources, and the few tests that should catch it run there. A mutation is caught if one of
them fails. The copy stays in one folder, so that what is compiled for one mutation is found by the next.

The script prints a table and ends with status 1 if a mutation survives. It ends with status 2 if a text that a
mutation changes is not found exactly once, or if the tests fail without any mutation.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from filecmp import cmp
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).parents[1]
COPIED = ("src", "tests", "validation", "pyproject.toml")
MAX_SECONDS = 1800.0  # [s] that the tests of one mutation may take
MODELS, LOADS = "tests/contracts/test_models.py", "tests/contracts/test_loads.py"
MATERIALS, CONTACT = "tests/tissue/test_materials.py", "tests/dynamics/contact/test_contact.py"


@dataclass(frozen=True)
class Mutation:
    """A mistake in the sources.

    Parameters
    ----------
    name : str
    file : str
        In `src/palpate`.
    old, new : str
        The text that is changed, which must occur once, and what takes its place.
    tests : tuple of str
        As pytest takes them.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


def contract(test: str, *kinds: str) -> tuple[str, ...]:
    """Return a test of the contract of models, for some kinds."""
    return tuple(f"{MODELS}::test_{test}[{kind}]" for kind in kinds)


def load(kind: str, way: str) -> tuple[str, ...]:
    """Return the test that a load moves a kind of model."""
    return (f"{LOADS}::test_a_load_moves_the_model_or_is_refused_by_name[{kind}-{way}]",)


MUTATIONS = (
    # laws
    Mutation(
        "dW/dJ of the neo-Hookean law", "tissue/materials.py",
        "return c[0], 0.0, -2.0 * c[0] / J", "return c[0], 0.0, -c[0] / J", (MATERIALS,),
    ),
    Mutation(
        "dW/dJ of Yeoh's law", "tissue/invariant_laws.py",
        "x * 3.0 * c[2])\n        return f1, 0.0, -2.0 * f1 / J", "x * 3.0 * c[2])\n        return f1, 0.0, -f1 / J",
        (MATERIALS,),
    ),
    Mutation(
        "second derivative of Gent's law", "tissue/invariant_laws.py",
        "f2 = 0.5 * c[0] / c[1] * r * r", "f2 = 0.5 * c[0] / c[1] * r", (MATERIALS,),
    ),
    Mutation(
        "pressure of a volumetric form", "tissue/volumetric.py",
        "return 0.5 * x * (2.0 + x) * r,", "return 0.5 * x * (1.0 + x) * r,", ("tests/tissue/test_volumetric.py",),
    ),
    Mutation(
        "chain rule of an isochoric law", "tissue/isochoric.py",
        "2.0 * x * V1 + 4.0 * y * V2) / (3.0 * J)", "2.0 * x * V1 + 2.0 * y * V2) / (3.0 * J)",
        ("tests/tissue/test_isochoric.py",),
    ),
    Mutation(
        "fibres carry compression", "tissue/fibres.py",
        "np.maximum(strain, 0.0), c[3]", "strain, c[3]", ("tests/tissue/test_fibres.py",),
    ),
    # loads
    Mutation(
        "a moment dropped in the full model", "dynamics/nodal/central_difference.py",
        "force += sites.dead_pattern", "force += 0.0 * sites.dead_pattern",
        load("solid, energy", "SurfaceForce, moment"),
    ),
    Mutation(
        "a moment dropped in the sampled model", "reduction/hyper/loads.py",
        'np.einsum("kac,mkc->am"', '0.0 * np.einsum("kac,mkc->am"', load("hyper-reduced", "SurfaceForce, moment"),
    ),
    Mutation(
        "a pressure dropped in the full model", "dynamics/nodal/central_difference.py",
        "surface[i, c] -= schedule.pressure[s, g]", "surface[i, c] -= 0.0 * schedule.pressure[s, g]",
        load("solid, energy", "Pressure, pressure"),
    ),
    Mutation(
        "a pressure that does not follow the face", "dynamics/nodal/central_difference.py",
        "area += cofactor[block, 3 * c + d, lane] * sites.", "area += (1.0 if c == d else 0.0) * sites.",
        ("tests/dynamics/solid/test_equilibrium.py::test_pressure_follows_the_face_as_it_stretches_and_turns",),
    ),
    Mutation(
        "a pressure dropped in the projected model", "reduction/galerkin/step.py",
        "for nodes in (sites.dead_node, sites.pressure_node):", "for nodes in (sites.dead_node, sites.dead_node[:0]):",
        ("tests/reduction/galerkin/test_model.py::test_a_full_rank_reduced_run_is_the_full_run",),
    ),
    Mutation(
        "gravity dropped in the projected model", "reduction/galerkin/model.py",
        "gravity_test=self.test", "gravity_test=0.0 * self.test", load("Galerkin", "Gravity, gravity"),
    ),
    Mutation(
        "a force dropped in the linear model", "reduction/lti/inputs.py",
        "values[:, entries] += schedule.amplitudes", "values[:, entries] += 0.0 * schedule.amplitudes",
        load("linear", "SurfaceForce, force"),
    ),
    Mutation(
        "springs dropped in real time", "realtime/bodies/model.py",
        "tools, _springs(model, foundations))", "tools, _springs(model, ()))",
        (f"{LOADS}::test_in_real_time_a_load_moves_a_sampled_model_or_is_refused_by_name[held-Foundation, springs]",),
    ),
    Mutation(
        "unknown loads taken by the sampled model", "reduction/hyper/loads.py",
        'check_kinds(\n        loads, PERMITTED_LOADS, "loads of a sampled',
        '(\n        loads, PERMITTED_LOADS, "loads of a sampled',
        (f"{LOADS}::test_a_new_kind_of_load_is_refused_until_a_model_has_forces_for_it[hyper-reduced]",),
    ),
    # constraints and contact
    Mutation(
        "supports let go", "dynamics/nodal/central_difference.py",
        "if sites.kind[i] == FREE:", "if sites.kind[i] <= FIXED:",
        contract("supports_and_tools_constrain_their_nodes", "solid, energy"),
    ),
    Mutation(
        "rollers let go", "dynamics/nodal/central_difference.py",
        "after = kick[0] * before + kick[1] * rate[c]", "after = before + kick[1] * scratch.force[i, c] / density",
        contract("supports_and_tools_constrain_their_nodes", "solid, rollers"),
    ),
    Mutation(
        "a roller's statics without its normal", "dynamics/loads/supports.py",
        "slide.append(np.eye(3) - held_directions.T @ held_directions)", "slide.append(np.eye(3))",
        ("tests/dynamics/loads/test_supports.py::test_the_surface_compliance_respects_rollers",),
    ),
    Mutation(
        "friction pushes on", "dynamics/contact/geometry.py",
        "share = friction * normal / speed", "share = -friction * normal / speed",
        (f"{CONTACT}::test_friction_sticks_inside_coulombs_cone_and_slides_on_it",),
    ),
    Mutation(
        "tools pull", "dynamics/contact/impulses.py",
        "if normal > 0.0:", "if normal != 0.0:",
        (f"{CONTACT}::test_a_tool_never_pulls_and_separates_at_once",),
    ),
    Mutation(
        "a tool's rotation", "dynamics/contact/geometry.py",
        "2 * (x * y - w * z), 2 * (x * z + w * y)", "2 * (x * y + w * z), 2 * (x * z + w * y)",
        (f"{CONTACT}::test_a_turning_tool_turns_sticking_tissue",),
    ),
    Mutation(
        "forceps turn the other way", "dynamics/contact/tools.py",
        "scalar_first=True).apply(arms)", "scalar_first=True).inv().apply(arms)",
        (f"{CONTACT}::test_forceps_hold_turn_and_release_tissue",),
    ),
    # states
    Mutation(
        "history not restored", "dynamics/material/relaxation.py",
        "array[:] = values", "array[:] = array",
        contract("results_do_not_depend_on_the_contents_of_the_workspace", "solid, relaxing"),
    ),
    Mutation(
        "history shared by two states", "dynamics/material/relaxation.py",
        "tuple(array.copy() for array in _persistent(variables))", "tuple(array for array in _persistent(variables))",
        contract("results_do_not_depend_on_the_contents_of_the_workspace", "solid, relaxing"),
    ),
    Mutation(
        "loads of one run act in the next", "dynamics/nodal/model.py",
        "work.step.surface[:] = 0.0", "work.step.surface[:0] = 0.0",
        contract("results_do_not_depend_on_the_contents_of_the_workspace", "solid, energy"),
    ),
    Mutation(
        "tools of one run taken for the next's", "reduction/hyper/model.py",
        "work.tools is None or work.tools.prepared is not ready", "work.tools is None",
        contract("results_do_not_depend_on_the_contents_of_the_workspace", "hyper-reduced, touched"),
    ),
    # energy and momentum
    Mutation(
        "viscous work missing in the full model", "dynamics/nodal/central_difference.py",
        "lost += change", "lost += 0.0 * change", contract("the_energy_balance_closes", "solid, energy"),
    ),
    Mutation(
        "viscous work missing in reduced models", "reduction/galerkin/central_difference.py",
        "work += (at[m] - a[m])", "work += 0.0 * (at[m] - a[m])",
        contract("the_energy_balance_closes", "hyper-reduced"),
    ),
    Mutation(
        "lost energy of a branch", "dynamics/material/relaxation.py",
        "0.5 * relaxation.moduli[k] * lost", "relaxation.moduli[k] * lost",
        contract("the_energy_balance_closes", "solid, relaxing"),
    ),
    Mutation(
        "work of a tool", "dynamics/nodal/central_difference.py",
        "inertia - scratch.force[i, c]", "inertia + scratch.force[i, c]",
        contract("the_energy_balance_closes", "solid, tool"),
    ),
    Mutation(
        "loads counted twice in reactions", "dynamics/nodal/model.py",
        "unbalanced -= external_force", "unbalanced -= 2.0 * external_force",
        contract("supports_bear_the_loads", "solid, strong"),
    ),
    Mutation(
        "factor at the boundary", "dynamics/solid/strong.py",
        "[self._face_nodes] /= self.half_cell", "[self._face_nodes] /= 1.0",
        ("tests/dynamics/solid/test_equilibrium.py::test_tractions_and_gravity_do_their_true_virtual_work_in_the_inner_product",),
    ),
    Mutation(
        "fluxes not reflected", "compiled/mirror.py",
        "mirror.reflection[k, c, 0] * flux[i, 0, d]", "abs(mirror.reflection[k, c, 0]) * flux[i, 0, d]",
        ("tests/meshfree/test_mirror.py::test_the_motion_of_a_turned_part_is_the_turned_motion",
         "tests/meshfree/test_mirror.py::test_the_stiffness_is_the_slope_of_the_forces_and_has_the_frequencies_of_the_whole_bar"),
    ),
    Mutation(
        "force of the images not the plane's", "dynamics/nodal/model.py",
        "result[plane.nodes] -= forces.sum(axis=0)", "result[plane.nodes] -= 0.0 * forces.sum(axis=0)",
        ("tests/meshfree/test_mirror.py::test_the_equilibrium_is_that_of_the_whole_bar",),
    ),
    # scenes
    Mutation(
        "tools at supports", "scenes/tool_paths.py",
        "reached & ~surface.held & (distances >= radius)", "reached & ~surface.held",
        ("tests/scenes/test_tool_paths.py::test_tools_keep_from_fixed_nodes",),
    ),
    Mutation(
        "slides over supports", "scenes/tool_paths.py",
        "np.all(fixed >= self.radius)", "np.all(fixed >= 0.0)",
        ("tests/scenes/test_tool_paths.py::test_slides_do_not_cross_supports",),
    ),
    Mutation(
        "slides through the body", "scenes/tool_paths.py",
        "np.all(gaps >= -MAX_SAG * depths - TOUCH_RADII * self.radius)", "np.all(gaps >= -self.radius)",
        ("tests/scenes/test_tool_paths.py::test_slides_over_a_bulge_are_not_deeper_than_presses",),
    ),
    Mutation(
        "balls in closed cavities", "scenes/tool_paths.py",
        "parts[tuple(index.T)] == parts[0, 0, 0]", "parts[tuple(index.T)] > 0",
        ("tests/scenes/test_tool_paths.py::test_a_closed_cavity_is_not_reached_though_the_ball_has_room_in_it",),
    ),
    Mutation(
        "places not spread", "scenes/tool_paths.py",
        "drawn[np.argmax(nearest[drawn])]", "drawn[0]",
        ("tests/scenes/test_tool_paths.py::test_training_places_are_spread_and_held_out_places_are_not",),
    ),
    Mutation(
        "coverage not chosen", "app/train/choose.py",
        "added[k] + _expected_error", "_expected_error",
        ("tests/app/train/test_coverage.py::test_uncovered_surface_comes_before_errors_and_errors_decide_on_covered_surface",),
    ),
    # reduction
    Mutation(
        "share of a load not counted", "reduction/hyper/error_indicator.py",
        "measures.load_shares / scales.load_scale", "0.0 * measures.load_shares",
        ("tests/reduction/hyper/test_load_share.py::test_a_load_across_the_symmetry_of_the_training_is_not_trusted",),
    ),
    Mutation(
        "energy of the surface compliance not counted", "realtime/bodies/error_indicator.py",
        "np.sqrt(flexible / data.indicator.scales.flexibility_scale)", "0.0 * np.sqrt(flexible)",
        ("tests/reduction/contact/test_trust_of_tools.py::test_the_engine_has_the_same_error_indicator_as_a_run",),
    ),
    Mutation(
        "bounds of frames, not of runs", "reduction/training/calibrate_indicator.py",
        "np.max(errors / numbers ** _exponent(largest[rest], peaks[rest]))",
        "np.median(errors / numbers ** _exponent(largest[rest], peaks[rest]))",
        ("tests/reduction/training/test_calibrate_indicator.py::test_error_bounds_hold_for_their_level_of_new_runs",),
    ),
    Mutation(
        "tools next to supports trusted", "reduction/hyper/error_indicator.py",
        "measures.nearness / scales.nearness_scale", "0.0 * measures.nearness",
        ("tests/reduction/contact/test_trust_of_tools.py::test_a_tool_next_to_a_support_is_not_trusted",),
    ),
    Mutation(
        "speed at which a tool moves back counted", "reduction/hyper/error_indicator.py",
        "np.maximum(np.sum(velocities * forces, axis=2) / size, 0.0)",
        "np.abs(np.sum(velocities * forces, axis=2) / size)",
        ("tests/reduction/contact/test_trust_of_tools.py::test_a_tool_that_moves_back_has_no_speed",),
    ),
    Mutation(
        "weights of the cubature ignored", "reduction/hyper/volume_terms.py",
        "weights[b, lane] * stress[b, q, lane]", "weights[0, 0] * stress[b, q, lane]",
        contract("the_energy_balance_closes", "hyper-reduced"),
    ),
    Mutation(
        "scale of the cubature's weights", "reduction/hyper/cubature.py",
        "return x / size,", "return x,", ("tests/reduction/hyper/test_cubature.py",),
    ),
    Mutation(
        "inner product of the modes", "reduction/basis/pod.py",
        "rows = shapes(modes) / roots", "rows = shapes(modes)", ("tests/reduction/basis/test_pod.py",),
    ),
    # files
    Mutation(
        "digest of an array not checked", "core/sealed.py",
        "or sha256(_bytes_of(values)).hexdigest() != digest", "or not digest",
        ("tests/reduction/storage/test_model_file.py::test_a_changed_entry_of_any_array_does_not_match_its_checksum",),
    ),
    Mutation(
        "stiffness damping not kept", "reduction/storage/body.py",
        '"stiffness_damping": float(stiffness_damping)', '"stiffness_damping": 2 * float(stiffness_damping)',
        (f"{MODELS}::test_a_loaded_model_has_the_same_run[hyper-reduced]",),
    ),
)  # fmt: skip


def refreshed(folder: Path) -> None:
    """Make a folder hold the present sources, and keep what was compiled of those that did not change."""
    wanted = {
        path.relative_to(ROOT)
        for name in COPIED
        for path in ([ROOT / name] if (ROOT / name).is_file() else (ROOT / name).rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }
    for path in [path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]:
        if path.relative_to(folder) not in wanted:
            path.unlink()
    for path in wanted:
        own = folder / path
        if not own.exists() or not cmp(ROOT / path, own, shallow=False):
            own.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / path, own)


def faults(mutations: Sequence[Mutation]) -> list[str]:
    """Return which mutations change a text that is not found exactly once."""
    found = []
    for each in mutations:
        path = ROOT / "src" / "palpate" / each.file
        count = path.read_text().count(each.old) if path.exists() else -1
        if count != 1:
            found.append(f"{each.name}: {each.old!r} occurs {count} times in {each.file}; it must occur once")
    return found


@contextmanager
def mutated(folder: Path, mutation: Mutation) -> Iterator[None]:
    """Change a file of the copy; afterwards restore it, with what was compiled of it."""
    path = folder / "src" / "palpate" / mutation.file
    backup = folder / "kept"
    shutil.rmtree(backup, ignore_errors=True)
    backup.mkdir()
    shutil.copy2(path, backup / path.name)
    cache = path.parent / "__pycache__"
    for compiled in cache.glob(f"{path.stem}.*.nb?"):
        shutil.copy2(compiled, backup / compiled.name)
    try:
        path.write_text(path.read_text().replace(mutation.old, mutation.new))
        yield
    finally:
        for compiled in cache.glob(f"{path.stem}.*.nb?"):
            compiled.unlink()
        for saved in backup.iterdir():
            shutil.copy2(saved, path if saved.name == path.name else cache / saved.name)
        shutil.rmtree(backup)


def tested(folder: Path, tests: Sequence[str]) -> tuple[int, str]:
    """Run some tests in the copy; return pytest's status, -1 after too long a time, and its last line."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--tb=no", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(folder / "src"), "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    environment.pop("NUMBA_CACHE_DIR", None)  # what is compiled stays next to the copy's sources
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=MAX_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return -1, f"not done after {MAX_SECONDS:g} s"
    lines = (done.stdout + done.stderr).strip().splitlines()
    return done.returncode, lines[-1] if lines else ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the mutations that are asked for; return the status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--only", default="", metavar="TEXT", help="mutations whose name or file has this text")
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "mutations", help="of the copy")
    parser.add_argument("--list", action="store_true", help="print the mutations and end")
    options = parser.parse_args(arguments)
    chosen = [each for each in MUTATIONS if options.only in each.name or options.only in each.file]
    wrong = faults(MUTATIONS)
    if wrong or not chosen:
        print("\n".join(wrong or [f"--only must be a part of a name or file, got {options.only!r}; see --list"]))
        return 2
    if options.list:
        print("\n".join(f"{each.file}: {each.name}" for each in chosen))
        return 0
    folder = options.folder.resolve()
    refreshed(folder)
    start = perf_counter()
    status, last = tested(folder, sorted({test for each in chosen for test in each.tests}))
    print(f"without a mutation: {last} ({perf_counter() - start:.0f} s)", flush=True)
    if status:
        print("the tests must pass without a mutation; repair them first")
        return 2
    survivors, broken = 0, 0
    for each in chosen:
        start = perf_counter()
        with mutated(folder, each):
            status, last = tested(folder, each.tests)
        outcome = {0: "SURVIVED", 1: "caught", -1: "caught"}.get(status, "BROKEN")
        survivors, broken = survivors + (outcome == "SURVIVED"), broken + (outcome == "BROKEN")
        print(f"{outcome:8} {each.name} ({each.file}): {last} ({perf_counter() - start:.0f} s)", flush=True)
    print(f"{len(chosen) - survivors - broken} of {len(chosen)} mutations are caught, {survivors} survive")
    return 2 if broken else int(survivors > 0)


if __name__ == "__main__":
    sys.exit(main())
