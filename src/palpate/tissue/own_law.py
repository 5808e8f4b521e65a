"""A law of one's own, from its energy written down: derivatives by SymPy, compiled and cached like every other law.

The text of an energy is read by Python's parser and built up from the few operations and functions that an energy may
have; nothing in it is ever run. SymPy differentiates it once, and the functions that are generated from it stand where
a built-in law has its own: the kernels inline them, and the cache finds them again in the next process by their source.
"""

from __future__ import annotations

import ast
import linecache
from dataclasses import make_dataclass
from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np

from palpate.faults import InputError
from palpate.tissue.ellipticity import material_stability
from palpate.tissue.isochoric import COUPLED
from palpate.tissue.materials import Material, parameter
from palpate.tissue.prony import Prony
from palpate.tissue.stretch_laws import StretchLaw
from palpate.tissue.volumetric import QUADRATIC

__all__ = ["Hyperelastic", "law_of"]

INVARIANTS, STRETCHES = ("I1", "I2", "J"), ("l1", "l2", "l3")
ISOCHORIC = {"I1bar": ("I1", -2), "I2bar": ("I2", -4)}  # I1 J^(-2/3), I2 J^(-4/3)
FUNCTIONS = ("exp", "log", "sqrt", "sinh", "cosh", "tanh", "atan")
OPERATIONS = {ast.Add: "__add__", ast.Sub: "__sub__", ast.Mult: "__mul__", ast.Div: "__truediv__", ast.Pow: "__pow__"}
VOLUMES = (0.9, 1.1)  # of the check of stability
LONGEST = 4000  # characters of an energy
NEARLY = 1e-9  # share of the sizes of the terms that their sum may miss of zero


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
        any other names.
    density : float [kg/m^3]
    poisson, bulk, prony, volumetric, split
        As for `palpate.Material`.
    stable : (float, float) or None
        Range of the principal stretches, around 1, in which the law must be strongly elliptic
        (`palpate.material_stability`, with volumes from 0.9 to 1.1); None takes it as it is.
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
        A text that is no energy, that cannot be differentiated, or is not symmetric in the stretches; a parameter that
        is missing or not in the text; an energy that is not finite or not free of stress at rest, has no positive
        moduli there, or is not elliptic in the range: with a report of where.

    Examples
    --------
    >>> law = Hyperelastic("C1 * (I1bar - 3) + C2 * (I1bar - 3)**2", C1=5e3, C2=1e3, density=1060, poisson=0.45)
    """
    if not isinstance(energy, str):
        raise InputError(f"energy is {energy!r}: write it down as text, such as 'C1 * (I1 - 3) - 2 * C1 * log(J)'")
    names = sorted(_names(_tree(energy)) - {*INVARIANTS, *STRETCHES, *ISOCHORIC})
    for name in names:
        if name not in parameters:
            raise InputError(f"the energy's parameter {name} is missing: give {name}=..., or correct its name")
    for name in parameters:
        if name not in names:
            raise InputError(f"{name} = {parameters[name]!r} is no parameter of the energy; it has {names or 'none'}")
    law = law_of(energy)
    values: dict[str, Any] = dict(parameters)
    material: Material = law(
        density=density, poisson=poisson, bulk=bulk, prony=prony, volumetric=volumetric, split=split, **values
    )
    if stable is not None:
        material_stability(material, stable, VOLUMES).require()
    return material


# reading


def _tree(text: str) -> ast.expr:
    if len(text) > LONGEST:
        raise InputError(f"the energy has {len(text)} characters; {LONGEST} are allowed")
    try:
        return ast.parse(" ".join(text.split()), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"the energy {text!r} cannot be read: {error}") from error


def _names(tree: ast.expr) -> set[str]:
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called}


def _symbolic(node: ast.expr, symbols: dict[str, Any]) -> Any:
    """Build SymPy's expression of a parsed one; refuse what no energy has."""
    import sympy

    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return sympy.Rational(repr(node.value))  # 1.5 is 3/2, so that powers stay exact
    if isinstance(node, ast.Name):
        return symbols[node.id]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _symbolic(node.operand, symbols)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATIONS:
        left, right = _symbolic(node.left, symbols), _symbolic(node.right, symbols)
        return getattr(left, OPERATIONS[type(node.op)])(right)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) == 1 and not node.keywords:
        if node.func.id in FUNCTIONS:
            return getattr(sympy, node.func.id)(_symbolic(node.args[0], symbols))
        raise InputError(f"the energy has the function {node.func.id}: it may have {', '.join(FUNCTIONS)}")
    raise InputError(f"the energy has {ast.unparse(node)!r}, which no energy may have")


# making


def law_of(energy: str) -> type[Material]:
    """Return the class of the materials of an energy's text (`Hyperelastic`).

    Raises
    ------
    InputError
        A text that is no energy.
    """
    _tree(energy)
    return _law(" ".join(energy.split()))


@cache
def _law(text: str) -> type[Material]:
    """Make the class of an energy's text, its functions generated."""
    import sympy

    tree = _tree(text)
    used = _names(tree)
    stretches = bool(used & set(STRETCHES))
    if stretches and used & {*INVARIANTS, *ISOCHORIC}:
        raise InputError("the energy is of invariants and of stretches: write it in one of them")
    if not used & {*INVARIANTS, *ISOCHORIC, *STRETCHES}:
        raise InputError("the energy does not depend on the deformation: it knows I1, I2, J, I1bar, I2bar, l1, l2, l3")
    variables = STRETCHES if stretches else INVARIANTS
    parameters = sorted(used - {*INVARIANTS, *STRETCHES, *ISOCHORIC})
    symbols = {name: sympy.Symbol(name, positive=True) for name in variables}
    given = {name: sympy.Symbol(f"c[{i}]", real=True) for i, name in enumerate(parameters)}
    third = sympy.Rational(1, 3)
    bars = {} if stretches else {n: symbols[i] * symbols["J"] ** (k * third) for n, (i, k) in ISOCHORIC.items()}
    energy = sympy.sympify(_symbolic(tree, symbols | given | bars))
    if stretches:
        _check_symmetry(energy, [symbols[name] for name in variables])
    functions = _functions(energy, [symbols[name] for name in variables], text)
    namespace: dict[str, Any] = {name: staticmethod(function) for name, function in functions.items()}
    base, moduli = (StretchLaw, _moduli_of_stretches) if stretches else (Material, _moduli_of_invariants)
    namespace |= {"shear_modulus": property(lambda self: moduli(self)[0]), "expression": text}
    namespace |= {
        "shear_bulk_modulus": property(lambda self: moduli(self)[1]),
        "_check_parameters": _check,
        "__module__": __name__,
    }
    own = [(name, float, parameter()) for name in parameters]
    return make_dataclass("Hyperelastic", own, bases=(base,), namespace=namespace, frozen=True, kw_only=True)


def _check_symmetry(energy: Any, stretches: list[Any]) -> None:
    """Refuse an energy that is not the same when two stretches change places."""
    import sympy

    one, two, three = stretches
    numbers = np.random.default_rng(0).uniform(0.7, 1.4, (3, 3))
    others = {symbol: sympy.Float(0.7 + 0.1 * i) for i, symbol in enumerate(sorted(energy.free_symbols, key=str))}
    for turned in ((two, one, three), (one, three, two)):
        change = energy - energy.subs(dict(zip(stretches, turned, strict=True)), simultaneous=True)
        for row in numbers:
            value = change.subs(others | dict(zip(stretches, row.tolist(), strict=True))).evalf()
            if not value.is_number or not abs(value) <= 1e-9 * (1 + abs(energy.subs(others).evalf())):
                raise InputError("the energy is not the same when two stretches change places: it is not isotropic")


def _functions(energy: Any, variables: list[Any], text: str) -> dict[str, Any]:
    """Generate energy, first and second from an expression, with sources that can be found again."""
    import sympy

    first = [sympy.diff(energy, v) for v in variables]
    if energy.has(sympy.nan, sympy.zoo, sympy.I) or any(d.has(sympy.Derivative, sympy.Subs) for d in first):
        raise InputError(f"the energy {text!r} cannot be differentiated")
    second = [sympy.diff(first[i], variables[j]) for i, j in _pairs(str(variables[0]) == STRETCHES[0])]
    source = "\n\n".join(
        _source(name, [str(v) for v in variables], results)
        for name, results in (("energy", [energy]), ("first", first), ("second", second))
    )
    filename = f"<palpate law {sha256(source.encode()).hexdigest()[:16]}>"
    linecache.cache[filename] = len(source), None, source.splitlines(keepends=True), filename
    made: dict[str, Any] = {"np": np}
    exec(compile(source, filename, "exec"), made)  # generated from what was allowed
    return {name: made[name] for name in ("energy", "first", "second")}


def _pairs(stretches: bool) -> list[tuple[int, int]]:
    """Which second derivatives a law has, in its order."""
    if stretches:
        return [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    return [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]


def _source(name: str, variables: list[str], results: list[Any]) -> str:
    """Return the text of a function of the variables and the coefficients c."""
    import sympy
    from sympy.printing.numpy import NumPyPrinter

    printer = NumPyPrinter({"fully_qualified_modules": False})

    def printed(value: Any) -> str:
        if value.is_number:
            return repr(float(value))
        text: str = printer.doprint(value)
        for function in FUNCTIONS:
            known = {"atan": "arctan"}.get(function, function)
            text = text.replace(f"{known}(", f"np.{known}(")
        return text

    shared, reduced = sympy.cse(results, symbols=sympy.numbered_symbols("s"), optimizations="basic")
    lines = [f"def {name}({', '.join(variables)}, c):"]
    lines += [f"    {symbol} = {printed(value)}" for symbol, value in shared]
    lines.append(f"    return {', '.join(printed(value) for value in reduced)}")
    return "\n".join(lines) + "\n"


# what rest must be


def _check(self: Any) -> None:
    """Refuse parameters with which rest is not finite, under stress, or soft."""
    super(type(self), self)._check_parameters()
    stretches = self.variables == "stretches"
    rest = (1.0, 1.0, 1.0) if stretches else (3.0, 3.0, 1.0)
    with np.errstate(all="ignore"):
        try:
            numbers = [float(self.law.energy(*rest, self.coefficients))]
            slopes = [float(s) for s in self.law.first(*rest, self.coefficients)]
            numbers += [*slopes, *(float(s) for s in self.law.second(*rest, self.coefficients))]
        except (ZeroDivisionError, ValueError, OverflowError) as error:
            raise InputError(f"the energy {self.expression!r} is not finite at rest: {error}") from error
    if not np.isfinite(numbers).all():
        raise InputError(f"the energy {self.expression!r} or a derivative of it is not finite at rest")
    parts = (slopes[0],) if stretches else (2 * slopes[0], 4 * slopes[1], slopes[2])
    stress, size = sum(parts), sum(map(abs, parts)) if not stretches else self.shear_modulus
    if abs(stress) > NEARLY * max(abs(size), 1e-300):
        advice = (
            "subtract a multiple of log(l1*l2*l3)"
            if stretches
            else "write it in I1bar and I2bar, or add a multiple of log(J)"
        )
        raise InputError(f"the energy {self.expression!r} has a stress of {stress:.4g} Pa at rest: {advice}")
    if not self.shear_modulus > 0:
        raise InputError(f"the energy {self.expression!r} has a shear modulus of {self.shear_modulus:.4g} Pa at rest")


def _moduli_of_invariants(material: Any) -> tuple[float, float]:
    """Shear and bulk modulus [Pa] at rest: of simple shear, and of w(l) = W(3 l^2, 3 l^4, l^3)."""
    c = material.coefficients
    W1, W2, WJ = (float(s) for s in material.first(3.0, 3.0, 1.0, c))
    W11, W12, W22, W1J, W2J, WJJ = (float(s) for s in material.second(3.0, 3.0, 1.0, c))
    slope, bend = np.array([6.0, 12.0, 3.0]), np.array([6.0, 36.0, 6.0])
    matrix = np.array([[W11, W12, W1J], [W12, W22, W2J], [W1J, W2J, WJJ]])
    return 2 * (W1 + W2), float(slope @ matrix @ slope + bend @ [W1, W2, WJ]) / 9


def _moduli_of_stretches(material: Any) -> tuple[float, float]:
    """Shear and bulk modulus [Pa] at rest."""
    W11, _, _, W12, _, _ = (float(s) for s in material.second(1.0, 1.0, 1.0, material.coefficients))
    return (W11 - W12) / 2, (W11 + 2 * W12) / 3
