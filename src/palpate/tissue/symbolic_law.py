"""Symbolic law: a material law from the text of its energy.

The text is checked against limits, parsed by Python's `ast`, and converted to a list of permitted
operations; it is never executed. The generated functions replace those of a built-in law. The
kernels inline them, and the cache of compiled code identifies them by their source.
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

from palpate.core.faults import InputError, brief
from palpate.core.files import shortened
from palpate.core.parameters import parameter
from palpate.tissue.ellipticity import material_stability
from palpate.tissue.isochoric import COUPLED
from palpate.tissue.materials import Material
from palpate.tissue.parameters import own_fields
from palpate.tissue.prony import Prony
from palpate.tissue.straight_line import FUNCTION_BY_NAME, Tape, compile_functions
from palpate.tissue.stretch_laws import StretchLaw
from palpate.tissue.volumetric import QUADRATIC

INVARIANT_NAMES, STRETCH_NAMES = ("I1", "I2", "J"), ("l1", "l2", "l3")
ISOCHORIC_POWERS = {"I1bar": ("I1", -2 / 3), "I2bar": ("I2", -4 / 3)}  # I1 J^(-2/3), I2 J^(-4/3)
PERMITTED_TEXT = "an expression of numbers, parameters, variables and the functions of `Hyperelastic`"
SIGN_BY_OPERATOR = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
SIGN_BY_UNARY = {ast.UAdd: "", ast.USub: "negative"}
TOKEN_PATTERN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\w.])|(?P<name>[A-Za-z_]\w*)|\*\*|[-+*/().])", re.ASCII
)
CHECKED_VOLUME_RATIOS = (0.9, 1.1)  # of the stability check
SYMMETRY_STRETCHES = (0.98, 1.02)  # of the symmetry check
RELATIVE_TOLERANCE = 1e-9  # of a sum that must be zero, over the size of its terms

# limits of a text: far beyond published laws, and compiled in seconds
MAX_CHARACTERS = 4000
MAX_WORD_CHARACTERS = 40  # of a number or a name
MAX_BRACKETS = 32  # nested
MAX_OPERATIONS = 250  # operators, signs and functions
MAX_PARAMETERS = 32
MAX_NUMBER, MIN_NUMBER = 1e30, 1e-30  # magnitudes of nonzero numbers
MAX_EXPONENT = 100.0  # powers of ordinary stretches overflow beyond it
MAX_TOTAL_OPERATIONS = 700  # operations of the energy and of its first and second derivatives together


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
    """Return a material from the text of its energy.

    Parameters
    ----------
    energy : str
        W_s [J/m^3] without its volumetric part U(J), in the notation of Python, of the invariants
        ``I1``, ``I2``, ``J`` of C and of ``I1bar`` = I1 J^(-2/3), ``I2bar`` = I2 J^(-4/3); or of
        the principal stretches ``l1``, ``l2``, ``l3``. It may hold ``+ - * / **``, exp, log, sqrt,
        sinh, cosh, tanh, atan, numbers, and parameters under other names. Limits: 4,000 characters,
        250 operations, 32 nested brackets and 32 parameters; magnitudes of numbers from 1e-30 to
        1e30; exponents from -100 to 100; 700 operations with all first and second derivatives.
        Names of Python or of `Material` are reserved.
    density : float [kg/m^3]
    poisson, bulk, prony, volumetric, split
        As for `palpate.materials.Material`.
    stable : (float, float) or None
        Range of the principal stretches, around 1, in which the law must be strongly elliptic
        (`palpate.materials.material_stability`, with volumes from 0.9 to 1.1); None omits the
        check.
    **parameters : float
        Values of the parameters of the energy, in SI units.

    Returns
    -------
    Material
        Material with the parameters as attributes, and `expression`, the text. Materials of equal
        text share one class, which is compiled once.

    Raises
    ------
    InputError
        The text is not a valid energy, exceeds the limits, or is not symmetric in the stretches; a
        parameter is missing or unknown; the energy is not finite or not free of stress at rest, has
        no positive moduli there, or is not elliptic in the range.

    Examples
    --------
    >>> import palpate as pt
    >>> energy = "C1 * (I1bar - 3) + C2 * (I1bar - 3)**2"
    >>> law = pt.materials.Hyperelastic(energy, C1=5e3, C2=1e3, density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), law.C2
    (10000.0, 1000.0)
    """
    law = law_of(energy)
    names = own_fields(law)
    if missing := [name for name in names if name not in parameters]:
        raise InputError(
            f"{' and '.join(missing)} must be given, because the energy holds {'it' if len(missing) == 1 else 'them'}; "
            f"add {', '.join(f'{name}=...' for name in missing)}, or correct the name: the energy depends on "
            f"{', '.join((*INVARIANT_NAMES, *ISOCHORIC_POWERS))}, or on {', '.join(STRETCH_NAMES)}"
        )
    for name in parameters:
        if name not in names:
            label = brief(parameters[name])
            raise InputError(f"a parameter must be one of {names or 'none'}, as in the energy, got {name} = {label}")
    values: dict[str, Any] = dict(parameters)
    material: Material = law(
        density=density, poisson=poisson, bulk=bulk, prony=prony, volumetric=volumetric, split=split, **values
    )
    if stable is not None:
        material_stability(material, stable, CHECKED_VOLUME_RATIOS).require()
    return material


# reading


def _parse(text: str) -> ast.expr:
    """Return the syntax tree of the text of an energy."""
    _check_limits(text)
    try:
        return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"the energy must be a valid expression, got {shortened(text)!r} ({error})") from None


def _check_limits(text: str) -> None:
    """Check a text before it is parsed, because the parser limits neither recursion nor numbers."""
    if len(text) > MAX_CHARACTERS:
        raise InputError(f"the energy must have at most {MAX_CHARACTERS} characters, got {len(text)}")
    at = depth = operations = 0
    while at < len(text):
        token = TOKEN_PATTERN.match(text, at)
        if not token:
            raise InputError(f"the energy must be {PERMITTED_TEXT}, got {shortened(text[at:].strip(), 20)!r}")
        word = token[0].strip()
        at, depth = token.end(), depth + (word == "(") - (word == ")")
        operations += word in SIGN_BY_OPERATOR.values() or (word in FUNCTION_BY_NAME)
        if len(word) > MAX_WORD_CHARACTERS:
            raise InputError(f"a word must have at most {MAX_WORD_CHARACTERS} characters, got {shortened(word, 20)!r}")
        if depth > MAX_BRACKETS or operations > MAX_OPERATIONS:
            limits = f"{MAX_OPERATIONS} operations and {MAX_BRACKETS} nested brackets"
            raise InputError(f"the energy must have at most {limits}, got more; shorten it")
        if token["number"] and float(word) and not MIN_NUMBER <= float(word) <= MAX_NUMBER:
            raise InputError(f"a number must be 0 or in [{MIN_NUMBER:g}, {MAX_NUMBER:g}], got {word}")
        if keyword.iskeyword(word):
            raise InputError(f"a name must not be a keyword of Python, got {word!r}; choose another name")


def _names(tree: ast.expr) -> set[str]:
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called}


def _energy_row(tree: ast.expr, tape: Tape, known: dict[str, int], text: str) -> int:
    """Return the row of a syntax tree; raise `InputError` for invalid nodes."""
    rows: dict[int, int] = {}
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.expr) and id(node) not in called]
    for node in reversed(nodes):  # from the operands up
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            rows[id(node)] = tape.number(float(node.value))  # type: ignore[arg-type]
        elif isinstance(node, ast.Name):
            rows[id(node)] = known[node.id]
        elif isinstance(node, ast.UnaryOp) and type(node.op) in SIGN_BY_UNARY:
            value = rows[id(node.operand)]
            rows[id(node)] = tape.apply("negative", value) if SIGN_BY_UNARY[type(node.op)] else value
        elif isinstance(node, ast.BinOp) and type(node.op) in SIGN_BY_OPERATOR:
            left, right = rows[id(node.left)], rows[id(node.right)]
            if isinstance(node.op, ast.Pow):
                _check_exponent(tape.value(right))
            rows[id(node)] = tape.apply(SIGN_BY_OPERATOR[type(node.op)], left, right)
        elif _is_plain_call(node):
            rows[id(node)] = tape.apply(node.func.id, rows[id(node.args[0])])  # type: ignore[attr-defined]
        else:
            label = shortened(text[node.col_offset : node.end_col_offset])
            raise InputError(f"the energy must be {PERMITTED_TEXT}, got {label!r}")
    return rows[id(tree)]


def _is_plain_call(node: ast.expr) -> bool:
    """Return whether a node calls a permitted function; raise `InputError` for other functions."""
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
        return False
    if len(node.args) != 1 or node.keywords or isinstance(node.args[0], ast.Starred):
        return False
    if node.func.id not in FUNCTION_BY_NAME:
        raise InputError(f"a function must be one of {', '.join(FUNCTION_BY_NAME)}, got {node.func.id}")
    return True


def _check_exponent(value: float | None) -> None:
    if value is not None and abs(value) > MAX_EXPONENT:
        raise InputError(f"an exponent must be in [{-MAX_EXPONENT:g}, {MAX_EXPONENT:g}], got {value:g}")


# making


def law_of(energy: str) -> type[Material]:
    """Return the class of materials of the text of an energy (`Hyperelastic`)."""
    if not isinstance(energy, str):
        raise InputError(f"energy must be text, got {brief(energy)}; an example is 'C1 * (I1 - 3) - 2 * C1 * log(J)'")
    if len(energy) > MAX_CHARACTERS:
        raise InputError(f"the energy must have at most {MAX_CHARACTERS} characters, got {len(energy)}")
    return _law(" ".join(energy.split()))


@cache
def _law(text: str) -> type[Material]:
    """Return the class of the text of an energy, with generated functions."""
    tree = _parse(text)
    used = _names(tree)
    stretches = bool(used & set(STRETCH_NAMES))
    if stretches and used & {*INVARIANT_NAMES, *ISOCHORIC_POWERS}:
        raise InputError("the energy must depend on invariants or on stretches, got both; use one of them")
    if not used & {*INVARIANT_NAMES, *ISOCHORIC_POWERS, *STRETCH_NAMES}:
        variables = "I1, I2, J, I1bar, I2bar, l1, l2, l3"
        raise InputError(f"the energy must depend on the deformation ({variables}), got {shortened(text)!r}")
    parameters = sorted(used - {*INVARIANT_NAMES, *STRETCH_NAMES, *ISOCHORIC_POWERS})
    base, moduli = (StretchLaw, _moduli_of_stretches) if stretches else (Material, _moduli_of_invariants)
    namespace: dict[str, Any] = {
        "shear_modulus": property(lambda self: moduli(self)[0]),
        "shear_bulk_modulus": property(lambda self: moduli(self)[1]),
        "expression": text,
        "_check_parameters": _check_rest,
        "__module__": __name__,
    }
    _check_names(parameters, {*dir(base), *namespace, *(field.name for field in fields(base))})
    functions = _functions(tree, text, STRETCH_NAMES if stretches else INVARIANT_NAMES, parameters)
    namespace |= {name: staticmethod(function) for name, function in functions.items()}
    entries = [(name, float, parameter()) for name in parameters]
    return make_dataclass("Hyperelastic", entries, bases=(base,), namespace=namespace, frozen=True, kw_only=True)


def _check_names(parameters: Sequence[str], reserved: set[str]) -> None:
    """Check the number of parameters and that their names are not reserved."""
    if len(parameters) > MAX_PARAMETERS:
        raise InputError(f"the energy must have at most {MAX_PARAMETERS} parameters, got {len(parameters)}")
    reserved = reserved | {*FUNCTION_BY_NAME, *dir(builtins), *inspect.signature(Hyperelastic).parameters}
    for name in parameters:
        if name.startswith("_") or name in reserved:
            raise InputError(f"a parameter must not have a reserved name, got {name}; choose another name")


def _functions(tree: ast.expr, text: str, variables: Sequence[str], parameters: Sequence[str]) -> dict[str, Any]:
    """Return the generated functions energy, first and second of a syntax tree."""
    tape = Tape(variables)
    known = {name: tape.variable(name) for name in variables}
    known |= {name: tape.coefficient(i) for i, name in enumerate(parameters)}
    if variables == INVARIANT_NAMES:
        for name, (invariant, power) in ISOCHORIC_POWERS.items():
            scale = tape.apply("**", known["J"], tape.number(power))
            known[name] = tape.apply("*", known[invariant], scale)
    energy = _energy_row(tree, tape, known, text)
    first = [tape.derivative(energy, variable) for variable in variables]
    second = [tape.derivative(first[i], variables[j]) for i, j in _pairs(variables == STRETCH_NAMES)]
    results = {"energy": [energy], "first": first, "second": second}
    steps = sum(len(tape.needed(rows)) for rows in results.values())
    if steps > MAX_TOTAL_OPERATIONS:
        raise InputError(
            f"the energy and its derivatives must take at most {MAX_TOTAL_OPERATIONS} operations, got {steps}; "
            "shorten the energy"
        )
    return compile_functions({name: tape.source(name, rows) for name, rows in results.items()}, variables)


def _pairs(stretches: bool) -> list[tuple[int, int]]:
    """Return the index pairs of the second derivatives, in the order of `second`."""
    if stretches:
        return [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    return [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]


# rest


def _check_rest(self: Any) -> None:
    """Check that rest is finite, free of stress and stiff, and that the law is isotropic."""
    super(type(self), self)._check_parameters()
    stretches, label = self.variables == "stretches", shortened(self.expression)
    slopes = _slopes_at_rest(self, label)
    if stretches:
        _check_symmetry(self)
    parts = (slopes[0],) if stretches else (2 * slopes[0], 4 * slopes[1], slopes[2])
    stress, size = sum(parts), sum(map(abs, parts)) if not stretches else self.shear_modulus
    if abs(stress) > RELATIVE_TOLERANCE * max(abs(size), 1e-300):
        advice = (
            "subtract a multiple of log(l1*l2*l3)"
            if stretches
            else "write it in I1bar and I2bar, or add a multiple of log(J)"
        )
        raise InputError(f"the stress of {label!r} at rest must be zero, got {stress:.4g} Pa; {advice}")
    if not 0 < self.shear_modulus < np.inf:
        raise InputError(f"the shear modulus of {label!r} at rest must be in (0, inf) Pa, got {self.shear_modulus:.4g}")


def _slopes_at_rest(material: Any, label: str) -> list[float]:
    """Return the first derivatives at rest; raise `InputError` if they are not finite."""
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
            raise InputError(f"the energy {label!r} must be finite at rest ({error})") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"the energy {label!r} and its derivatives must be finite at rest")
    return slopes


def _check_symmetry(material: Any) -> None:
    """Check that an energy is symmetric in the stretches."""
    one, two, three = np.random.default_rng(0).uniform(*SYMMETRY_STRETCHES, (3, 20))
    with np.errstate(all="ignore"):
        value = material.energy(one, two, three, material.coefficients)
        size = np.abs(value) + sum(map(np.abs, material.first(one, two, three, material.coefficients)))
        for turned in ((two, one, three), (one, three, two)):
            change = np.abs(material.energy(*turned, material.coefficients) - value)
            if not np.all(change <= RELATIVE_TOLERANCE * size):
                raise InputError(
                    "the energy must be symmetric in the stretches; an anisotropic energy is not supported"
                )


def _moduli_of_invariants(material: Any) -> tuple[float, float]:
    """Return shear and bulk modulus [Pa] at rest: of simple shear, and of w(l) = W(3 l^2, 3 l^4, l^3)."""
    c = material.coefficients
    W1, W2, WJ = (float(s) for s in material.first(3.0, 3.0, 1.0, c))
    W11, W12, W22, W1J, W2J, WJJ = (float(s) for s in material.second(3.0, 3.0, 1.0, c))
    slope, bend = np.array([6.0, 12.0, 3.0]), np.array([6.0, 36.0, 6.0])
    matrix = np.array([[W11, W12, W1J], [W12, W22, W2J], [W1J, W2J, WJJ]])
    with np.errstate(all="ignore"):
        return 2 * (W1 + W2), float(slope @ matrix @ slope + bend @ [W1, W2, WJ]) / 9


def _moduli_of_stretches(material: Any) -> tuple[float, float]:
    """Return shear and bulk modulus [Pa] at rest."""
    W11, _, _, W12, _, _ = (float(s) for s in material.second(1.0, 1.0, 1.0, material.coefficients))
    return (W11 - W12) / 2, (W11 + 2 * W12) / 3
