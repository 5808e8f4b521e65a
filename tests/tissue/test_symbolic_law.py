"""Symbolic laws: their functions are those of the equal built-in law, and invalid texts are refused."""

from __future__ import annotations

import linecache
import subprocess
import sys
from time import process_time

import numpy as np
import pytest

import palpate as pt
from palpate.tissue.parameters import own_fields
from palpate.tissue.straight_line import Tape, compile_functions
from palpate.tissue.symbolic_law import Hyperelastic, law_of

REST = {"density": 1000.0, "poisson": 0.45}
TWINS = {
    "neo": ("C1*(I1 - 3) - 2*C1*log(J)", {"C1": 5e3}, lambda p: pt.materials.NeoHookean(**p, **REST)),
    "mooney": (
        "C1/2*(I1 - 3) + C2/2*(I2 - 3) - (C1 + 2*C2)*log(J)", {"C1": 8e3, "C2": 2e3},
        lambda p: pt.materials.MooneyRivlin(**p, **REST),
    ),
    "yeoh": (
        "C1*(I1 - 3 - 2*log(J)) + C2*(I1 - 3 - 2*log(J))**2 + C3*(I1 - 3 - 2*log(J))**3",
        {"C1": 5e3, "C2": 1e3, "C3": 200.0}, lambda p: pt.materials.Yeoh(**p, **REST),
    ),
    "fung": ("mu/(2*b)*(exp(b*(I1 - 3 - 2*log(J))) - 1)", {"mu": 1e4, "b": 0.6},
             lambda p: pt.materials.Fung(**p, **REST)),
    "ogden": (
        "C*(l1**a + l2**a + l3**a - 3 - a*log(l1*l2*l3))", {"C": 800.0, "a": 4.0},
        lambda p: pt.materials.Ogden(C=p["C"], alpha=p["a"], **REST),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TWINS)
def test_a_symbolic_law_equals_the_built_in_law_of_the_same_energy(name, deformations):
    text, parameters, built_in = TWINS[name]
    own, other = Hyperelastic(text, **parameters, **REST), built_in(parameters)
    np.testing.assert_allclose(own.strain_energy(deformations), other.strain_energy(deformations), rtol=1e-10)
    np.testing.assert_allclose(own.stress(deformations), other.stress(deformations), rtol=1e-9, atol=1e-7)
    assert own.shear_modulus == pytest.approx(other.shear_modulus, rel=1e-12)
    assert own.shear_bulk_modulus == pytest.approx(other.shear_bulk_modulus, rel=1e-12)
    assert own.bulk == pytest.approx(other.bulk, rel=1e-12)


@pytest.mark.slow
@pytest.mark.each_kind(name=["mooney"])
@pytest.mark.parametrize(("name", "form"), [("mooney", "strong"), ("ogden", "energy")])
def test_a_body_of_a_symbolic_law_has_the_forces_of_the_built_in_law(name, form):
    text, parameters, built_in = TWINS[name]
    cloud = pt.box((0.03, 0.01, 0.01), 0.0025)
    own = pt.Solid(cloud, Hyperelastic(text, **parameters, **REST), "x-", form=form, stiffness_damping=1e-5)
    other = pt.Solid(cloud, built_in(parameters), "x-", form=form, stiffness_damping=1e-5)
    u = 0.1 * np.sin(60 * cloud.points) * 0.01
    expected = other.force(u)
    np.testing.assert_allclose(own.force(u), expected, atol=1e-9 * np.abs(expected).max())


def test_isochoric_invariants_do_not_change_with_the_volume(deformations):
    symbolic = Hyperelastic("C1*(I1bar - 3) + C2*(I2bar**1.5 - 3*sqrt(3))", C1=5e3, C2=100.0, **REST)
    np.testing.assert_allclose(
        symbolic.shear_energy(1.3 * deformations), symbolic.shear_energy(deformations), rtol=1e-12
    )
    assert symbolic.shear_bulk_modulus == pytest.approx(0, abs=1e-8)


def test_the_stress_is_the_slope_of_the_energy(deformations):
    symbolic = Hyperelastic("C1*(I1bar - 3) + C2*sinh(I2bar - 3)**2 + k*(J - 1)**4", C1=5e3, C2=900.0, k=1e3, **REST)
    step = 1e-6
    for F in deformations:
        for i in np.ndindex(3, 3):
            change = np.zeros((3, 3))
            change[i] = step
            slope = (symbolic.strain_energy(F + change) - symbolic.strain_energy(F - change)) / (2 * step)
            assert symbolic.stress(F)[i] == pytest.approx(slope, rel=1e-6, abs=1e-2)


def test_equal_texts_share_one_class_for_any_parameters_and_spaces():
    one, two = (Hyperelastic("C1 * (I1bar-3)", C1=c, **REST) for c in (1.0, 2.0))
    assert type(one) is type(two)
    assert (one.C1, two.C1) == (1.0, 2.0)
    assert type(Hyperelastic("C1  *  (I1bar-3)", C1=1.0, **REST)) is type(one)
    assert one.expression == "C1 * (I1bar-3)"


REFUSED = {
    "stress at rest": ("C1*(I1 - 3)", {"C1": 1.0}, r"at rest must be zero, got 2 Pa; write it in I1bar"),
    "stretches at rest": ("C1*(l1 + l2 + l3)", {"C1": 1.0}, r"at rest must be zero, got 1 Pa; subtract"),
    "no text": (3.0, {}, r"energy must be text"),
    "no expression": ("C1*(I1bar - 3", {"C1": 1.0}, r"must be a valid expression"),
    "a call": ("I1bar + __import__('os').getpid()", {}, r"must be an expression of"),
    "an attribute": ("I1bar.real", {}, r"must be an expression of .*, got 'I1bar.real'"),
    "a string": ("I1bar + 'a'", {}, r"must be an expression of"),
    "a function": ("abs(I1bar)", {}, r"a function must be one of exp, log.*, got abs"),
    "two kinds": ("I1bar + l1", {}, r"must depend on invariants or on stretches"),
    "no deformation": ("C1", {"C1": 1.0}, r"must depend on the deformation"),
    "anisotropic": ("C1*(l1 - log(l1))", {"C1": 1.0}, r"must be symmetric in the stretches"),
    "missing": ("C1*(I1bar - 3)", {}, r"C1 must be given"),
    "unknown": ("C1*(I1bar - 3)", {"C1": 1.0, "C2": 2.0}, r"a parameter must be one of .*, got C2 = 2.0"),
    "no number": ("C1*(I1bar - 3)", {"C1": "a"}, r"C1 must be a number"),
    "infinite": ("C1*log(J - 1) + I1bar", {"C1": 1.0}, r"finite at rest"),
    "singular slope": ("C1*sqrt(I1bar - 3)", {"C1": 1.0}, r"finite at rest"),
    "soft": ("-C1*(I1bar - 3)", {"C1": 1.0}, r"shear modulus of .*, got -2"),
    "long": ("I1bar" + " + 1" * 2000, {}, r"at most 4000 characters"),
}


def test_an_unstable_law_is_refused_with_a_report_unless_it_is_allowed():
    text, parameters = "C1*(I1bar - 3) - C2*(I1bar - 3)**2", {"C1": 5e3, "C2": 3e4}
    with pytest.raises(pt.InputError, match=r"not elliptic, worst at principal stretches"):
        Hyperelastic(text, **parameters, **REST)
    assert Hyperelastic(text, stable=(0.97, 1.03), **parameters, **REST).C2 == 3e4
    assert Hyperelastic(text, stable=None, **parameters, **REST).C2 == 3e4


@pytest.mark.parametrize("case", REFUSED)
def test_texts_that_are_not_an_energy_are_refused(case):
    text, parameters, message = REFUSED[case]
    with pytest.raises(pt.InputError, match=message):
        Hyperelastic(text, **parameters, **REST)


@pytest.mark.slow
@pytest.mark.release
def test_another_process_finds_the_compiled_law_in_the_cache(tmp_path):
    script = """
import sys, palpate as pt
from palpate.materials import Hyperelastic
law = Hyperelastic("C1*(I1bar - 3) + C2*(I1bar - 3)**2", C1=5e3, C2=1e3, density=1000, poisson=0.45)
body = pt.Solid(pt.box((0.03, 0.01, 0.01), 0.0025), law, "x-", form="energy", stiffness_damping=1e-5)
force = body._internal_force
body.force(body.cloud.points * 0)
print(sum(force.stats.cache_hits.values()), sum(force.stats.cache_misses.values()))
"""
    environment = {"NUMBA_CACHE_DIR": str(tmp_path), "PATH": "", "PYTHONPATH": ":".join(sys.path)}
    said = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True)
        for _ in range(2)
    ]
    assert [run.stdout.split() for run in said] == [["0", "1"], ["1", "0"]]


X, EVEN = "(I1 - 3 - 2*log(J))", "(I1 - 2*log(J))"
LONG = {
    "six terms of Ogden": " + ".join(
        f"C{i}*(l1**a{i} + l2**a{i} + l3**a{i} - 3 - a{i}*log(l1*l2*l3))" for i in range(6)
    ),
    "Rivlin's polynomial of the fourth order": " + ".join(
        f"C{i}{j}*(I1bar - 3)**{i}*(I2bar - 3)**{j}" for i in range(5) for j in range(5 - i) if i + j
    ),
    "Arruda and Boyce": (
        f"mu*({X}/2 + ({EVEN}**2 - 9)/(20*N) + 11*({EVEN}**3 - 27)/(1050*N**2) + 19*({EVEN}**4 - 81)/(7000*N**3) "
        f"+ 519*({EVEN}**5 - 243)/(673750*N**4))"
    ),
    "exponentials": "C*(exp(a*(I1bar - 3) + b*(I1bar - 3)**2 + d*(I2bar - 3)) - 1) + D*(exp(e*(I2bar - 3)**2) - 1)",
    "Gent": f"-mu/2*Jm*log(1 - {X}/Jm)",
    "Saint Venant": "mu/4*(I1**2 - 2*I2 - 2*I1 + 3)",
    "functions": "sqrt(I1)*tanh(I2/J) + sinh(0.1*I1)/cosh(J) - atan(I2*J)**3 + 2**J + J**(-1/3) - (-I1)**2 + J**a",
}  # fmt: skip


@pytest.mark.parametrize("name", LONG)
def test_derivatives_equal_those_of_sympy(name):
    sympy = pytest.importorskip("sympy")
    law = law_of(LONG[name])
    stretches = law.variables == "stretches"
    variables = sympy.symbols("l1 l2 l3" if stretches else "I1 I2 J", positive=True)
    names = own_fields(law)
    rng = np.random.default_rng(0)
    values = dict(zip(names, rng.uniform(0.5, 2.0, len(names)), strict=True))
    local = {str(v): v for v in variables}
    if not stretches:
        I1, I2, J = variables
        local |= {"I1bar": I1 * J ** sympy.Rational(-2, 3), "I2bar": I2 * J ** sympy.Rational(-4, 3)}
    printed = sympy.sympify(LONG[name], locals={**local, **{n: sympy.Float(v, 17) for n, v in values.items()}})
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    pairs = pairs if stretches else [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    first = [sympy.diff(printed, v) for v in variables]
    expected = [printed, *first, *(sympy.diff(first[i], variables[j]) for i, j in pairs)]
    point = rng.uniform(0.9, 1.1, 3) * ((1, 1, 1) if stretches else (3, 3, 1))
    c = tuple(values[n] for n in names)
    found = [law.energy(*point, c), *law.first(*point, c), *law.second(*point, c)]
    exact = [float(e.subs(dict(zip(variables, point, strict=True)))) for e in expected]
    np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())


HARMFUL = {
    "a tower of powers": "I1bar + 9**9**9",
    "powers of a power": "I1bar**2**2**2**2**2**2",
    "a power of powers": "((((I1bar**99)**99)**99)**99)**1e5",
    "exponentials in one another": "exp(" * 90 + "I1bar" + ")" * 90,
    "many more": "exp(" * 190 + "I1bar" + ")" * 190,
    "constant exponentials": "I1bar + exp(exp(exp(exp(100))))",
    "constants that cancel": "exp(exp(exp(exp(exp(I1bar/I1bar + 5)))))",
    "a hidden power": "exp(1e29*log(2*I1bar))**99",
    "an infinite number": "I1bar*1e999",
    "a large number": "I1bar*1e300",
    "large numbers": "I1bar*(1e30**1e30)",
    "a small number": "I1bar*1e-300",
    "a root of less than nothing": "I1bar*(-8)**(1/3)",
    "a division by nothing": "I1bar/0",
    "many digits": "I1bar*" + "7" * 3000,
    "a hexadecimal number": "I1bar*0x" + "f" * 3000,
    "a number with underscores": "I1bar*1_0",
    "an imaginary number": "I1bar*1j",
    "signs": "-" * 3000 + "I1bar",
    "brackets": "(" * 1900 + "I1bar" + ")" * 1900,
    "closed brackets": ")" * 3000,
    "a chain of powers": "I1bar**" * 500 + "1",
    "a long sum": "I1bar" + "+1" * 1900,
    "a product of sums": "*".join(f"(I1bar + c{i}*I2bar + J)" for i in range(32)),
    "many parameters": "+".join(f"c{i}*I1bar" for i in range(33)),
    "a long name": "I1bar*" + "a" * 3000,
    "many operations": "sinh(I1bar*J)*" * 130 + "J",
    "nested functions": "sqrt(I1bar + exp(J*" * 15 + "I2bar" + "))" * 15,
    "fullwidth letters": "\uff29\uff11 + I1bar",
    "a name that normalises": "I1bar*\u212b",
    "half a surrogate pair": "I1bar*'\ud800'",
    "a null byte": "I1bar\0",
    "an assignment": "(I1bar := 3)",
    "a condition": "I1bar if J else 1",
    "a comprehension": "I1bar + sum(x for x in (1, 2))",
    "a function of nothing": "I1bar + exp()",
    "starred arguments": "I1bar + exp(*J)",
    "a called result": "I1bar + exp(J)(J)",
    "ellipsis": "I1bar + ...",
    "a truth value": "I1bar + True",
    "floor division": "I1bar // 2",
    "an attribute of a number": "I1bar + 1 .real",
    "nothing": "",
    "a comment": "I1bar # + 1",
}


@pytest.mark.parametrize("case", HARMFUL)
def test_harmful_texts_are_refused_in_one_line(case):
    begun = process_time()
    with pytest.raises(pt.InputError) as refusal:
        Hyperelastic(HARMFUL[case], **REST, **{f"c{i}": 1.0 for i in range(33) if f"c{i}*" in HARMFUL[case]})
    assert len(str(refusal.value).splitlines()) == 1
    assert len(str(refusal.value)) < 400
    assert process_time() - begun < 5.0


TAKEN = [
    *("energy", "law", "first", "second", "stress", "variables", "expression", "density", "poisson", "bulk", "prony"),
    *("volumetric", "split", "coefficients", "shear_modulus", "lame", "stable", "__dict__", "__class__", "_x", "_"),
    *("print", "sum", "exp", "atan", "None", "lambda", "is", "shear_stress", "_check_parameters"),
]


@pytest.mark.parametrize("name", TAKEN)
def test_parameters_with_reserved_names_are_refused(name):
    with pytest.raises(pt.InputError, match=r"reserved name|a keyword of Python|must be an expression of"):
        law_of(f"{name}*(I1bar - 3)")
    with pytest.raises(pt.InputError, match=r"reserved name|a keyword of Python|must be an expression of"):
        law_of(f"{name}*(l1 + l2 + l3 - 3 - log(l1*l2*l3))")


def test_parameters_may_have_the_names_used_in_generated_code():
    text = "MISSING*(I1bar - 3) + self*(I2bar - 3) + c*(J - 1)**2 + np*(J - 1)**4 + s3*(J - 1)**6 + match*(J - 1)**2"
    names = dict.fromkeys(("MISSING", "self", "c", "np", "s3", "match"), 1e3)
    law = law_of(text)
    assert own_fields(law) == sorted(names)
    assert law(**REST, **names).shear_modulus == pytest.approx(4e3)


@pytest.mark.parametrize(
    "code",
    [
        "__import__('os')", "().__class__", "np.load(J)", "np.exp.__globals__", "open(J)", "c[J]", "c.x",
        "J if c else J", "c", "np.exp", "np.exp(c)", "c[1.0]", "c[True]", "c[0][0]", "c['a']",
        "[J]", "(lambda: J)()", "'a'", "np.exp(J, J)", "np", "x", "True", "f'{J}'", "(J := 1.0)", "np.exp(*c)",
        "c[0:1]", "J == J", "J and J", "{J}", "np.exp(x=J)", "1j", "~c[0]", "J.real", "(yield J)",
    ],
)  # fmt: skip
def test_generated_code_that_is_not_arithmetic_is_not_executed(code, monkeypatch):
    monkeypatch.setattr(Tape, "_row_source", lambda tape, row: code)
    before = len(linecache.cache)
    with pytest.raises(pt.InputError, match="it is not executed"):
        law_of("C1*(I1bar - 3) + 0.125*J")
    assert len(linecache.cache) == before


@pytest.mark.parametrize(
    "source",
    [
        "import os\n", "def energy(I1, I2, J, c=1):\n    return J\n", "def energy(I1, I2, J, *c):\n    return J\n",
        "@np.exp\ndef energy(I1, I2, J, c):\n    return J\n", "def energy(I1, I2, J, c) -> J:\n    return J\n",
        "def energy(I1: J, I2, J, c):\n    return J\n", "def other(I1, I2, J, c):\n    return J\n",
        "def energy(I1, I2, J, c):\n    global J\n    return J\n",
        "def energy(I1, I2, J, c):\n    np = J\n    return J\n", "def energy(I1, I2, J):\n    return J\n",
        "def energy(I1, I2, J, c):\n    return J\nprint(1)\n",
        "def energy(I1, I2, J, c):\n    def energy(J): return J\n",
        "def energy(I1, I2, J, c):\n    J = 1\n    return J\n",
        "def energy(I1, I2, J, c):\n    c[0] = J\n    return J\n", "def energy(np, I2, J, c):\n    return J\n",
    ],
)  # fmt: skip
def test_sources_that_use_other_names_are_not_executed(source):
    with pytest.raises(pt.InputError, match="it is not executed"):
        compile_functions({"energy": source}, ("I1", "I2", "J"))


WORDS = (
    *"+-*/()()", "**", "**", "exp(", "log(", "sqrt(", "tanh(", "I1bar", "I2bar", "J", "I1", "l1", "l2", "l3", "C1", "b",
    "3", "0", "1e30", "1e-30", "0.5", "100", "-1", "99", " ", ",", ".", "e", "1e", "if", "**-", "energy", "__",
    "²", "\n", "#",
)  # fmt: skip


@pytest.mark.filterwarnings("ignore::palpate.core.faults.UnitWarning")
def test_random_texts_give_a_law_or_are_refused():
    rng, made = np.random.default_rng(0), 0
    for _ in range(1500):
        text = "".join(WORDS[i] for i in rng.integers(len(WORDS), size=rng.integers(1, 12)))
        if rng.integers(2):
            text = f"C1*(I1bar - 3) + b*(J - 1)**2*({text})"
        values = {name: rng.choice([0.0, 1.0, -1.0, 1e3, 1e300, 5e-324]) for name in ("C1", "b") if name in text}
        try:
            assert Hyperelastic(text, **values, **REST, stable=(0.97, 1.03)).shear_modulus > 0
            made += 1
        except pt.InputError as error:
            message = str(error)
            assert "\n" not in message or "not stable for" in message
    assert made > 3


def test_cancelling_factors_do_not_change_the_law():
    law = law_of("C1*(I1bar - 3)*exp(I2bar/I2bar - 1)**99")
    assert law(C1=1.0, **REST).shear_modulus == pytest.approx(2.0)
