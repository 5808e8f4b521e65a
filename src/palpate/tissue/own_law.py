"""A law of one's own, from its energy written down: differentiated, compiled and cached like every other law.

The text of an energy is checked against limits, split by Python's parser, and built up from the few operations and
functions that an energy may have; nothing in it is ever run. The functions that are generated from it stand where a
built-in law has its own: the kernels inline them, and the cache finds them again in the next process by their source.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import keyword
import re
from collections.abc import Sequence
from dataclasses import fields, make_dataclass
from functools import cache
from typing import Any

import numpy as np

from palpate.faults import InputError, brief
from palpate.files import shortened
from palpate.tissue.ellipticity import material_stability
from palpate.tissue.isochoric import COUPLED
from palpate.tissue.materials import Material, parameter
from palpate.tissue.parameters import own_fields
from palpate.tissue.prony import Prony
from palpate.tissue.straight_line import FUNCTIONS, Tape, compiled_functions
from palpate.tissue.stretch_laws import StretchLaw
from palpate.tissue.volumetric import QUADRATIC

__all__ = ["Hyperelastic", "law_of"]

INVARIANTS, STRETCHES = ("I1", "I2", "J"), ("l1", "l2", "l3")
ISOCHORIC = {"I1bar": ("I1", -2 / 3), "I2bar": ("I2", -4 / 3)}  # I1 J^(-2/3), I2 J^(-4/3)
OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
SIGNS = {ast.UAdd: "", ast.USub: "negative"}
TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\w.])|(?P<name>[A-Za-z_]\w*)|\*\*|[-+*/().])", re.ASCII
)
VOLUMES = (0.9, 1.1)  # of the check of stability
NEAR_REST = (0.98, 1.02)  # stretches of the check of symmetry
NEARLY = 1e-9  # share of the sizes of the terms that their sum may miss of zero

# limits of a text, far beyond any published law, within which it compiles in seconds
LONGEST = 4000  # characters
LONGEST_WORD = 40  # characters of a number or a name
DEEPEST = 32  # brackets within brackets
MOST_OPERATIONS = 250  # operators, signs and functions
MOST_PARAMETERS = 32
LARGEST, LEAST = 1e30, 1e-30  # sizes of a number that is not zero
STEEPEST = 100.0  # an exponent that is a number; beyond it powers of ordinary stretches overflow
MOST_STEPS = 700  # operations of the energy and of its first and second derivatives together


def Hyperelastic(
    energy: str,
    *,
    density: float,
    poisson: float | None = None,
    bulk: float | None = None,
    prony: Prony | None = None,
    stable: tuple[float, float] | None = (0.8, 1.25),
    volumetric: str = QUADRATIC,
    split: str = COUPLED,
    **parameters: float,
) -> Material:
    """Return the material of an energy that is written down.

    Parameters
    ----------
    energy : str
        W_s [J/m^3] without its volumetric part U(J), in the notation of Python, of the invariants ``I1``,
        ``I2``, ``J`` of C and of ``I1bar`` = I1 J^(-2/3), ``I2bar`` = I2 J^(-4/3); or of the principal stretches
        ``l1``, ``l2``, ``l3``. With + - * / **, exp, log, sqrt, sinh, cosh, tanh, atan, numbers, and parameters under
        any other names. At most 4,000 characters, 250 operations, 32 brackets in one another and 32 parameters, whose
        names neither Python nor a material has; numbers of a size from 1e-30 to 1e30; exponents from -100 to 100; 700
        operations with all first and second derivatives.
    density : float [kg/m^3]
    poisson, bulk, prony, volumetric, split
        As for `palpate.materials.Material`.
    stable : (float, float) or None
        Range of the principal stretches, around 1, in which the law must be strongly elliptic
        (`palpate.materials.material_stability`, with volumes from 0.9 to 1.1); None takes it as it is.
    **parameters : float
        The values of the energy's parameters, in SI units.

    Returns
    -------
    Material
        With the parameters as attributes, and `expression`, the energy's text. Two materials of the same text are of
        the same class, which is compiled once.

    Raises
    ------
    InputError
        A text that is no energy, is beyond the limits, or is not symmetric in the stretches; a parameter that
        is missing or not in the text; an energy that is not finite or not free of stress at rest, has no positive
        moduli there, or is not elliptic in the range: with a report of where.

    Examples
    --------
    >>> law = Hyperelastic("C1 * (I1bar - 3) + C2 * (I1bar - 3)**2", C1=5e3, C2=1e3, density=1060, poisson=0.45)
    """
    law = law_of(energy)
    names = own_fields(law)
    for name in names:
        if name not in parameters:
            raise InputError(f"the energy's parameter {name} is missing: give {name}=..., or correct its name")
    for name in parameters:
        if name not in names:
            said = brief(parameters[name])
            raise InputError(f"{name} = {said} is no parameter of the energy; it has {names or 'none'}")
    values: dict[str, Any] = dict(parameters)
    material: Material = law(
        density=density, poisson=poisson, bulk=bulk, prony=prony, volumetric=volumetric, split=split, **values
    )
    if stable is not None:
        material_stability(material, stable, VOLUMES).require()
    return material


# reading


def _tree(text: str) -> ast.expr:
    """Return the parsed text of an energy, in one line.

    Raises
    ------
    InputError
        It is beyond the limits, or has what no energy may have.
    """
    _check_limits(text)
    try:
        return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"the energy {shortened(text)!r} cannot be read: {error}") from None


def _check_limits(text: str) -> None:
    """Refuse a text before the parser has it, whose recursion and whose numbers have no limits of their own."""
    if len(text) > LONGEST:
        raise InputError(f"the energy has {len(text)} characters; {LONGEST} are allowed")
    at = depth = operations = 0
    while at < len(text):
        token = TOKEN.match(text, at)
        if not token:
            raise InputError(f"the energy has {shortened(text[at:].strip(), 20)!r}, which no energy may have")
        word = token[0].strip()
        at, depth = token.end(), depth + (word == "(") - (word == ")")
        operations += word in OPERATORS.values() or (word in FUNCTIONS)
        if len(word) > LONGEST_WORD:
            raise InputError(f"the energy has {shortened(word, 20)!r}; {LONGEST_WORD} characters of it are allowed")
        if depth > DEEPEST or operations > MOST_OPERATIONS:
            limits = f"{MOST_OPERATIONS} operations, or {DEEPEST} brackets in one another"
            raise InputError(f"the energy has more than {limits}; shorten it")
        if token["number"] and float(word) and not LEAST <= float(word) <= LARGEST:
            raise InputError(f"the energy has the number {word}: allowed are 0 and {LEAST:g} to {LARGEST:g}")
        if keyword.iskeyword(word):
            raise InputError(
                f"the energy has {word!r}, a word of Python, which no energy may have; choose another name"
            )


def _names(tree: ast.expr) -> set[str]:
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called}


def _energy_row(tree: ast.expr, tape: Tape, known: dict[str, int], text: str) -> int:
    """Return the row of a parsed energy; refuse what no energy has."""
    rows: dict[int, int] = {}
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.expr) and id(node) not in called]
    for node in reversed(nodes):  # from the operands up
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            rows[id(node)] = tape.number(float(node.value))  # type: ignore[arg-type]
        elif isinstance(node, ast.Name):
            rows[id(node)] = known[node.id]
        elif isinstance(node, ast.UnaryOp) and type(node.op) in SIGNS:
            value = rows[id(node.operand)]
            rows[id(node)] = tape.apply("negative", value) if SIGNS[type(node.op)] else value
        elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            left, right = rows[id(node.left)], rows[id(node.right)]
            if isinstance(node.op, ast.Pow):
                _check_exponent(tape.value(right))
            rows[id(node)] = tape.apply(OPERATORS[type(node.op)], left, right)
        elif _is_plain_call(node):
            rows[id(node)] = tape.apply(node.func.id, rows[id(node.args[0])])  # type: ignore[attr-defined]
        else:
            said = shortened(text[node.col_offset : node.end_col_offset])
            raise InputError(f"the energy has {said!r}, which no energy may have")
    return rows[id(tree)]


def _is_plain_call(node: ast.expr) -> bool:
    """Return whether a node calls a function of an energy; refuse other functions."""
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
        return False
    if len(node.args) != 1 or node.keywords or isinstance(node.args[0], ast.Starred):
        return False
    if node.func.id not in FUNCTIONS:
        raise InputError(f"the energy has the function {node.func.id}: it may have {', '.join(FUNCTIONS)}")
    return True


def _check_exponent(value: float | None) -> None:
    if value is not None and abs(value) > STEEPEST:
        raise InputError(f"the energy has the exponent {value:g}: allowed are {-STEEPEST:g} to {STEEPEST:g}")


# making


def law_of(energy: str) -> type[Material]:
    """Return the class of the materials of an energy's text (`Hyperelastic`).

    Raises
    ------
    InputError
        A text that is no energy, or is beyond the limits.
    """
    if not isinstance(energy, str):
        raise InputError(f"energy is {brief(energy)}: write it down as text, such as 'C1 * (I1 - 3) - 2 * C1 * log(J)'")
    if len(energy) > LONGEST:
        raise InputError(f"the energy has {len(energy)} characters; {LONGEST} are allowed")
    return _law(" ".join(energy.split()))


@cache
def _law(text: str) -> type[Material]:
    """Make the class of an energy's text, its functions generated."""
    tree = _tree(text)
    used = _names(tree)
    stretches = bool(used & set(STRETCHES))
    if stretches and used & {*INVARIANTS, *ISOCHORIC}:
        raise InputError("the energy is of invariants and of stretches: write it in one of them")
    if not used & {*INVARIANTS, *ISOCHORIC, *STRETCHES}:
        raise InputError("the energy does not depend on the deformation: it knows I1, I2, J, I1bar, I2bar, l1, l2, l3")
    parameters = sorted(used - {*INVARIANTS, *STRETCHES, *ISOCHORIC})
    base, moduli = (StretchLaw, _moduli_of_stretches) if stretches else (Material, _moduli_of_invariants)
    namespace: dict[str, Any] = {
        "shear_modulus": property(lambda self: moduli(self)[0]),
        "shear_bulk_modulus": property(lambda self: moduli(self)[1]),
        "expression": text,
        "_check_parameters": _check,
        "__module__": __name__,
    }
    _check_names(parameters, {*dir(base), *namespace, *(field.name for field in fields(base))})
    functions = _functions(tree, text, STRETCHES if stretches else INVARIANTS, parameters)
    namespace |= {name: staticmethod(function) for name, function in functions.items()}
    own = [(name, float, parameter()) for name in parameters]
    return make_dataclass("Hyperelastic", own, bases=(base,), namespace=namespace, frozen=True, kw_only=True)


def _check_names(parameters: Sequence[str], taken: set[str]) -> None:
    """Refuse parameters that would hide what a law or Python has under their name, and too many."""
    if len(parameters) > MOST_PARAMETERS:
        raise InputError(f"the energy has {len(parameters)} parameters; {MOST_PARAMETERS} are allowed")
    taken = taken | {*FUNCTIONS, *dir(builtins), *inspect.signature(Hyperelastic).parameters}
    for name in parameters:
        if name.startswith("_") or name in taken:
            raise InputError(f"the energy's parameter {name} has a name that is taken; choose another")


def _functions(tree: ast.expr, text: str, variables: Sequence[str], parameters: Sequence[str]) -> dict[str, Any]:
    """Generate energy, first and second from a parsed energy."""
    tape = Tape(variables)
    known = {name: tape.variable(name) for name in variables}
    known |= {name: tape.coefficient(i) for i, name in enumerate(parameters)}
    if variables == INVARIANTS:
        for name, (invariant, power) in ISOCHORIC.items():
            scale = tape.apply("**", known["J"], tape.number(power))
            known[name] = tape.apply("*", known[invariant], scale)
    energy = _energy_row(tree, tape, known, text)
    first = [tape.derivative(energy, variable) for variable in variables]
    second = [tape.derivative(first[i], variables[j]) for i, j in _pairs(variables == STRETCHES)]
    results = {"energy": [energy], "first": first, "second": second}
    steps = sum(len(tape.needed(rows)) for rows in results.values())
    if steps > MOST_STEPS:
        raise InputError(
            f"the energy takes {steps} operations with its first and second derivatives; "
            f"{MOST_STEPS} are allowed: shorten it"
        )
    return compiled_functions({name: tape.source(name, rows) for name, rows in results.items()}, variables)


def _pairs(stretches: bool) -> list[tuple[int, int]]:
    """Which second derivatives a law has, in its order."""
    if stretches:
        return [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    return [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]


# what rest must be


def _check(self: Any) -> None:
    """Refuse parameters with which rest is not finite, under stress, or soft, or the law is not isotropic."""
    super(type(self), self)._check_parameters()
    stretches, said = self.variables == "stretches", shortened(self.expression)
    slopes = _slopes_at_rest(self, said)
    if stretches:
        _check_symmetry(self)
    parts = (slopes[0],) if stretches else (2 * slopes[0], 4 * slopes[1], slopes[2])
    stress, size = sum(parts), sum(map(abs, parts)) if not stretches else self.shear_modulus
    if abs(stress) > NEARLY * max(abs(size), 1e-300):
        advice = (
            "subtract a multiple of log(l1*l2*l3)"
            if stretches
            else "write it in I1bar and I2bar, or add a multiple of log(J)"
        )
        raise InputError(f"the energy {said!r} has a stress of {stress:.4g} Pa at rest: {advice}")
    if not 0 < self.shear_modulus < np.inf:
        raise InputError(f"the energy {said!r} has a shear modulus of {self.shear_modulus:.4g} Pa at rest")


def _slopes_at_rest(material: Any, said: str) -> list[float]:
    """Return the first derivatives at rest; refuse a law that is not finite there."""
    rest, c, law = (
        (1.0, 1.0, 1.0) if material.variables == "stretches" else (3.0, 3.0, 1.0),
        material.coefficients,
        material.law,
    )
    with np.errstate(all="ignore"):
        try:
            slopes = [float(s) for s in law.first(*rest, c)]
            numbers = [float(law.energy(*rest, c)), *slopes, *(float(s) for s in law.second(*rest, c))]
        except (ArithmeticError, TypeError, ValueError) as error:  # a division by zero, or a complex number
            raise InputError(f"the energy {said!r} is not finite at rest: {error}") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"the energy {said!r} or a derivative of it is not finite at rest")
    return slopes


def _check_symmetry(material: Any) -> None:
    """Refuse an energy that is not the same when two stretches change places."""
    one, two, three = np.random.default_rng(0).uniform(*NEAR_REST, (3, 20))
    with np.errstate(all="ignore"):
        here = material.energy(one, two, three, material.coefficients)
        size = np.abs(here) + sum(map(np.abs, material.first(one, two, three, material.coefficients)))
        for turned in ((two, one, three), (one, three, two)):
            change = np.abs(material.energy(*turned, material.coefficients) - here)
            if not np.all(change <= NEARLY * size):
                raise InputError("the energy is not the same when two stretches change places: it is not isotropic")


def _moduli_of_invariants(material: Any) -> tuple[float, float]:
    """Shear and bulk modulus [Pa] at rest: of simple shear, and of w(l) = W(3 l^2, 3 l^4, l^3)."""
    c = material.coefficients
    W1, W2, WJ = (float(s) for s in material.first(3.0, 3.0, 1.0, c))
    W11, W12, W22, W1J, W2J, WJJ = (float(s) for s in material.second(3.0, 3.0, 1.0, c))
    slope, bend = np.array([6.0, 12.0, 3.0]), np.array([6.0, 36.0, 6.0])
    matrix = np.array([[W11, W12, W1J], [W12, W22, W2J], [W1J, W2J, WJJ]])
    with np.errstate(all="ignore"):
        return 2 * (W1 + W2), float(slope @ matrix @ slope + bend @ [W1, W2, WJ]) / 9


def _moduli_of_stretches(material: Any) -> tuple[float, float]:
    """Shear and bulk modulus [Pa] at rest."""
    W11, _, _, W12, _, _ = (float(s) for s in material.second(1.0, 1.0, 1.0, material.coefficients))
    return (W11 - W12) / 2, (W11 + 2 * W12) / 3
