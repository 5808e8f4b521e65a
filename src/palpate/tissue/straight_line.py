"""Straight-line programs of energies, their exact derivatives and their code.

An expression is the index of a row in a `Tape`. Every row is one operation on earlier rows, and
equal operations share a row. A derivative adds a few rows for each row that it depends on, so the
length of second derivatives is proportional to that of the energy. All numbers are floats.
"""

from __future__ import annotations

import ast
import linecache
import math
import operator
import re
from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256
from typing import Any

import numpy as np

from palpate.core.faults import InputError

Row = tuple[str, float | str | int, int]  # operation with a value, a name, or one or two earlier rows

FUNCTION_BY_NAME: dict[str, Any] = {
    "exp": np.exp, "log": np.log, "sqrt": np.sqrt, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "atan": np.arctan,
}  # fmt: skip
NUMPY_NAMES = {name: function.__name__ for name, function in FUNCTION_BY_NAME.items()}
OPERATION_BY_SIGN: dict[str, Callable[[float, float], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "**": operator.pow,
}  # fmt: skip
NO_OPERAND = -1  # second operand of a unary operation


class Tape:
    """Straight-line program: rows of operations on coefficients and on positive variables."""

    def __init__(self, variables: Sequence[str]) -> None:
        self.rows: list[Row] = []
        self._known: dict[Row, int] = {}
        self._slopes: dict[str, dict[int, int]] = {name: {} for name in variables}

    def number(self, value: float) -> int:
        """Return the row of a number."""
        if isinstance(value, complex) or not math.isfinite(value):
            raise InputError(f"constant parts of the energy must be finite and real, got {value}")
        return self._row("number", float(value))

    def variable(self, name: str) -> int:
        """Return the row of a variable."""
        return self._row("variable", name)

    def coefficient(self, place: int) -> int:
        """Return the row of a coefficient."""
        return self._row("coefficient", place)

    def apply(self, operation: str, first: int, second: int = NO_OPERAND) -> int:
        """Return the row of a binary operator, a function or ``"negative"`` applied to rows."""
        one, two = self.value(first), self.value(second)
        if one is not None and (two is not None or second == NO_OPERAND):
            return self.number(_fold(operation, one, two))
        if operation == "+" and 0.0 in (one, two):
            return second if one == 0 else first
        if operation == "-" and 0.0 in (one, two):
            return first if two == 0 else self.apply("negative", second)
        if operation == "*" and 0.0 in (one, two):
            return self.number(0.0)
        if operation == "*" and 1.0 in (one, two):
            return second if one == 1 else first
        if (operation == "/" and one == 0) or (operation == "**" and two == 0):
            return self.number(0.0 if operation == "/" else 1.0)
        if operation in ("/", "**") and two == 1:
            return first
        if operation in ("+", "*") and first > second:
            first, second = second, first
        return self._row(operation, first, second)

    def derivative(self, row: int, variable: str) -> int:
        """Return the row of the derivative of a row by a variable."""
        slopes = self._slopes[variable]
        for i in self.needed([row]):
            if i not in slopes:
                slopes[i] = self._slope(i, variable, slopes)
        return slopes[row]

    def needed(self, rows: Sequence[int]) -> list[int]:
        """Return rows and all their operands, in order."""
        rows_needed, left = set(rows), list(rows)
        while left:
            new = set(self._operands(left.pop())) - rows_needed
            rows_needed |= new
            left += new
        return sorted(rows_needed)

    def source(self, name: str, results: Sequence[int]) -> str:
        """Return the source of a function of the variables and the coefficients c that computes rows."""
        needed = [i for i in self.needed(results) if self._operands(i)]
        lines = [f"def {name}({', '.join(self._slopes)}, c):"]
        lines += [f"    s{i} = {self._row_source(i)}" for i in needed]
        lines.append(f"    return {', '.join(map(self._row_name, results))}")
        return "\n".join(lines) + "\n"

    def _row(self, operation: str, first: float | str | int, second: int = NO_OPERAND) -> int:
        row = operation, first, second
        if row not in self._known:
            self._known[row] = len(self.rows)
            self.rows.append(row)
        return self._known[row]

    def value(self, row: int) -> float | None:
        """Return the value of a constant row, or None."""
        return self.rows[row][1] if row != NO_OPERAND and self.rows[row][0] == "number" else None  # type: ignore[return-value]

    def _operands(self, row: int) -> tuple[int, ...]:
        operation, first, second = self.rows[row]
        if operation in ("number", "variable", "coefficient"):
            return ()
        return (first,) if second == NO_OPERAND else (first, second)  # type: ignore[return-value]

    def _slope(self, row: int, variable: str, slopes: dict[int, int]) -> int:
        """Return the derivative of a row from those of its operands."""
        operation, first, second = self.rows[row]
        if not self._operands(row):
            return self.number(float(operation == "variable" and first == variable))
        a, b, apply = int(first), second, self.apply
        da, db = slopes[a], slopes[b] if b != NO_OPERAND else NO_OPERAND
        if operation in ("+", "-"):
            return apply(operation, da, db)
        if operation == "*":
            return apply("+", apply("*", da, b), apply("*", a, db))
        if operation == "/":
            return apply("/", apply("-", da, apply("*", row, db)), b)
        if operation == "**":
            steady = apply("*", self._power_slope(row, a, b), da)
            if self.value(db) == 0:
                return steady
            return apply("+", steady, apply("*", apply("*", row, apply("log", a)), db))
        return self._function_slope(operation, row, a, da)

    def _power_slope(self, row: int, base: int, exponent: int) -> int:
        """Return the derivative of a power by its base; a base that is not a variable may be zero."""
        value = self.value(exponent)
        if self.rows[base][0] == "variable" and not (value is not None and value.is_integer()):
            return self.apply("/", self.apply("*", exponent, row), base)
        less = self.apply("-", exponent, self.number(1.0))
        return self.apply("*", exponent, self.apply("**", base, less))

    def _function_slope(self, operation: str, row: int, a: int, da: int) -> int:
        apply, one = self.apply, self.number(1.0)
        if operation == "negative":
            return apply("negative", da)
        if operation == "log":
            return apply("/", da, a)
        if operation == "sqrt":
            return apply("/", apply("*", self.number(0.5), da), row)
        if operation == "atan":
            return apply("/", da, apply("+", one, apply("*", a, a)))
        if operation == "tanh":
            return apply("*", apply("-", one, apply("*", row, row)), da)
        slope = row if operation == "exp" else apply({"sinh": "cosh", "cosh": "sinh"}[operation], a)
        return apply("*", slope, da)

    def _row_source(self, row: int) -> str:
        operation, first, second = self.rows[row]
        a = self._row_name(int(first))
        if operation == "negative":
            return f"-{a}"
        if second == NO_OPERAND:
            return f"np.{NUMPY_NAMES[operation]}({a})"
        power = self.value(second) if operation == "**" else None
        if power == 0.5:
            return f"np.sqrt({a})"
        if power is not None and power.is_integer():
            return f"{a} ** ({int(power)})"  # compiled as products
        return f"{a} {operation} {self._row_name(second)}"

    def _row_name(self, row: int) -> str:
        operation, first, _ = self.rows[row]
        if operation == "number":
            return f"({first!r})"
        if operation == "coefficient":
            return f"c[{first}]"
        return str(first) if operation == "variable" else f"s{row}"


def _fold(operation: str, one: float, two: float | None) -> Any:
    """Return the result of an operation on constants, NaN if undefined."""
    try:
        with np.errstate(all="ignore"):
            if two is None:
                return -one if operation == "negative" else float(FUNCTION_BY_NAME[operation](one))
            return OPERATION_BY_SIGN[operation](one, two)
    except (ZeroDivisionError, OverflowError):
        return math.nan


# compiling


ARITHMETIC_NODES = (
    ast.Module, ast.Return, ast.Tuple, ast.Load, ast.Store, ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow,
    ast.UnaryOp, ast.USub,
)  # fmt: skip
NAME_PATTERN = re.compile(r"s\d+")


def compile_functions(sources: dict[str, str], variables: Sequence[str]) -> dict[str, Any]:
    """Return compiled functions by name, with sources available to `inspect`.

    The sources by function name are results of `Tape.source`.
    """
    source = "\n\n".join(sources.values())
    filename = f"<palpate law {sha256(source.encode()).hexdigest()[:16]}>"
    tree = ast.parse(source, filename)
    if [getattr(node, "name", "") for node in tree.body] != list(sources):
        raise InputError("generated code must define the functions of the energy only; it is not executed")
    for node in _walk(tree):
        if not (_is_known_call(node) or _is_coefficient(node) or _is_arithmetic(node, variables)):
            raise InputError(f"generated code must be arithmetic, got {type(node).__name__}; it is not executed")
    linecache.cache[filename] = len(source), None, source.splitlines(keepends=True), filename
    made: dict[str, Any] = {"np": np, "__builtins__": {}}
    exec(compile(tree, filename, "exec"), made)  # arithmetic alone, as checked above
    return {name: made[name] for name in sources}


def _is_arithmetic(node: ast.AST, variables: Sequence[str]) -> bool:
    """Return whether a node is one that `Tape.source` writes; its children are checked separately."""
    if isinstance(node, ast.FunctionDef):
        plain = not node.decorator_list and node.returns is None
        plain = plain and [arg.arg for arg in node.args.args] == [*variables, "c"]
        return plain and all(isinstance(line, ast.Assign | ast.Return) for line in node.body)
    if isinstance(node, ast.arguments):
        return not (node.posonlyargs or node.kwonlyargs or node.vararg or node.kwarg or node.defaults)
    if isinstance(node, ast.arg):
        return node.annotation is None
    if isinstance(node, ast.Assign):
        return all(isinstance(target, ast.Name) and NAME_PATTERN.fullmatch(target.id) for target in node.targets)
    if isinstance(node, ast.Name):
        return node.id in variables or bool(NAME_PATTERN.fullmatch(node.id))
    if isinstance(node, ast.Constant):
        return type(node.value) in (int, float)
    return isinstance(node, ARITHMETIC_NODES)


def _walk(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a tree, with only ``x`` below a call ``np.f(x)`` and nothing below ``c[0]``."""
    left = [tree]
    while left:
        node = left.pop()
        yield node
        if not _is_coefficient(node):
            left += node.args if isinstance(node, ast.Call) and _is_known_call(node) else ast.iter_child_nodes(node)


def _is_known_call(node: ast.AST) -> bool:
    """Return whether a node calls one of `FUNCTION_BY_NAME` by its NumPy name."""
    if not (isinstance(node, ast.Call) and len(node.args) == 1 and not node.keywords):
        return False
    called = node.func
    if not (isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name)):
        return False
    return called.value.id == "np" and called.attr in NUMPY_NAMES.values()


def _is_coefficient(node: ast.AST) -> bool:
    """Return whether a node is c with an integer index."""
    if not (isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and isinstance(node.ctx, ast.Load)):
        return False
    return node.value.id == "c" and isinstance(node.slice, ast.Constant) and type(node.slice.value) is int
