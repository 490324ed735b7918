"""Claims about expressions: what they mean is what Python means by them, and nothing else can be written."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workers.model.expression import DEEPEST, FUNCTIONS, MAX_LENGTH, ExpressionError, parse

NAMES = ("omega", "a", "b", "mu_k")
VALUES = {"omega": 1.7, "a": 0.3, "b": -2.0, "mu_k": 5.0}


def value(text: str, **values: float) -> float:
    arrays = {name: np.full(3, number) for name, number in (VALUES | values).items()}
    with np.errstate(all="ignore"):
        return float(parse(text, NAMES)(arrays)[0])


@pytest.mark.parametrize(
    "text",
    [
        "1", "2.5e-3", ".5", "5.", "a", "a + b * omega", "(a + b) * omega", "a - b - omega", "a / b / omega",
        "-a**2", "2**-1", "2**3**2", "-2*a", "a*-b", "+a", "--a", "omega**2*a", "a**0", "2*(1 + mu_k)",
        "  a\n+\tb ", "1 - a",
    ],
)  # fmt: skip
def test_an_expression_means_what_it_means_in_python(text: str) -> None:
    assert value(text) == eval(" ".join(text.split()), dict(VALUES))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pi", math.pi), ("sqrt(2)", math.sqrt(2)), ("sin(a)", math.sin(0.3)), ("cos(pi)", -1.0),
        ("tan(a)", math.tan(0.3)), ("exp(1)", math.e), ("log(exp(1))", 1.0), ("abs(b)", 2.0), ("min(a, b)", -2.0),
        ("max(a, b, omega)", 1.7), ("atan2(a, b)", math.atan2(0.3, -2.0)),
        ("omega**0.5", math.sqrt(1.7)), ("omega**-3", 1.7**-3), ("a**omega", 0.3**1.7),
    ],
)  # fmt: skip
def test_functions_and_pi_have_their_values(text: str, expected: float) -> None:
    assert value(text) == pytest.approx(expected, rel=1e-15)


@settings(deadline=None)
@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_arithmetic_is_that_of_doubles(a: float, b: float) -> None:
    """To the bit: one rounding for each operation, in the order in which Python has them."""
    assert value("a * b - a * a + 2 * b", a=a, b=b) == a * b - a * a + 2 * b


@pytest.mark.parametrize("text", ["1 / (a - a)", "sqrt(b)", "log(0)", "9**9**9", "exp(1000)", "1e308 * 10"])
def test_what_has_no_finite_value_is_infinite_or_nan_at_once(text: str) -> None:
    """9**9**9 as a whole number would have 370 million digits; every number here is a double."""
    assert not math.isfinite(value(text))


@pytest.mark.parametrize("function", [*FUNCTIONS, "power", "whole power"])
def test_an_element_does_not_depend_on_those_beside_it_to_the_bit(function: str) -> None:
    """numpy has several ways to compute a function, and which one it takes may depend on how many numbers there are."""
    two = function in ("min", "max", "atan2")
    text = {"power": "a ** b", "whole power": "a ** 7"}.get(function, f"{function}(a, b)" if two else f"{function}(a)")
    rng = np.random.default_rng(1)
    many = {name: rng.uniform(0.5, 3.0, 203) for name in NAMES}
    many["b"][::3] = 2.0
    expression = parse(text, NAMES)
    whole = expression(many)
    for begin, end in ((0, 2), (1, 4), (100, 109), (190, 203)):
        part = expression({name: values[begin:end].copy() for name, values in many.items()})
        assert part.tobytes() == whole[begin:end].tobytes()


HOSTILE = [
    ("__import__('os')", "found \"'\""),
    ("__import__(os)", "unknown function '__import__'"),
    ("eval(a)", "unknown function 'eval'"),
    ("a.real", "found '.'"),
    ("a.__class__", "found '.'"),
    ("().__class__", "found '.'"),
    ("(" * 100_000 + "1" + ")" * 100_000, f"found 200001 characters, must be at most {MAX_LENGTH}"),
    ("(" * 200 + "1" + ")" * 200, f"nested more than {DEEPEST} deep"),
    ("-" * 200 + "1", f"nested more than {DEEPEST} deep"),
    ("2" + "**2" * 100, f"nested more than {DEEPEST} deep"),
    ("sqrt(" * 80 + "1" + ")" * 80, f"nested more than {DEEPEST} deep"),
    ("1" * 400, "beyond the range of double precision"),
    ("1e999", "beyond the range of double precision"),
    ("a + " * 200, "characters, must be at most"),
    ("lambda: 1", "found ':'"),
    ("lambda", "unknown name 'lambda'"),
    ("[a for a in b]", "found '['"),
    ("{a}", "found '{'"),
    ("'text'", "found \"'\""),
    ("f'{a}'", "found \"'\""),
    ("a if b else a", "found 'if' after 'a', must be an operator"),
    ("a and b", "found 'and' after 'a'"),
    ("a := 1", "found ':'"),
    ("a = 1", "found '='"),
    ("a < b", "found '<'"),
    ("a // b", "found '/', must be a number, a name or a parenthesis"),
    ("a % b", "found '%'"),
    ("a; b", "found ';'"),
    ("a, b", "found ',' after 'a'"),
    ("2a", "found 'a' after '2'"),
    ("1_000", "found '_000' after '1'"),
    ("0x10", "found 'x10' after '0'"),
    ("1j", "found 'j' after '1'"),
    ("", "found nothing at all"),
    ("   ", "found nothing at all"),
    ("a +", "found nothing after '+'"),
    ("(a", "found the end, must be a closing parenthesis"),
    ("a)", "found ')' after 'a'"),
    ("*a", "found '*'"),
    ("sin", "unknown name 'sin'"),
    ("sin()", "found ')'"),
    ("sin(a, b)", "found sin with 2, must have 1 argument"),
    ("atan2(a)", "found atan2 with 1, must have 2 arguments"),
    ("min(a)", "found min with 1, must have 2 to 8 arguments"),
    ("mu_kk", "unknown name 'mu_kk'; did you mean 'mu_k'?"),
    ("F*sin(omega*t)", "unknown name 'F'"),
    ("sin(omega*t)", "unknown name 't'; an entry knows neither time nor state, only "),
    ("mu_k*x**2", "unknown name 'x'; an entry knows neither time nor state, only "),
    ("sqr(a)", "unknown function 'sqr'; did you mean 'sqrt'?"),
    ("(a, b)", "found ',' after 'a'"),
    ("()", "found ')'"),
    ("sin(a,)", "found ')'"),
    ("sin(*a)", "found '*'"),
    ("max(**a)", "found '**'"),
    ("(sin)(a)", "found '(' after ')'"),
    ("2(3)", "found '(' after '2'"),
    ("a if", "found 'if' after 'a'"),
    ("a # b", "found '#'"),
    ("omega\x00", "found '\\x00'"),
    ("аlpha", "found 'а'"),
    ("a−b", "found '−'"),
    ("１", "found '１'"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), HOSTILE, ids=[f"{k}" for k in range(len(HOSTILE))])
def test_whatever_else_is_written_gets_one_line(text: str, message: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        parse(text, NAMES)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 200


@given(st.text(max_size=60))
def test_any_text_is_an_expression_or_gets_its_line(text: str) -> None:
    try:
        found = parse(text, NAMES)
    except ExpressionError as error:
        assert len(str(error).splitlines()) == 1
    else:
        assert parse(found.text, NAMES) == found


@given(st.text("ab+-*/()., 12eE", max_size=40))
def test_a_uniform_spelling_is_the_same_expression(text: str) -> None:
    try:
        found = parse(text, NAMES)
    except ExpressionError:
        return
    assert parse(found.text, NAMES) == found
    assert pickle.loads(pickle.dumps(found)) == found


@pytest.mark.parametrize("name", ["lambda", "if", "None", "True", "not", "_", "__debug__", "e1"])
def test_a_keyword_of_python_is_a_name_as_any_other(name: str) -> None:
    expression = parse(f"2 * {name} + {name}**2", (name,))
    assert expression.names == {name}
    assert expression({name: np.full(2, 3.0), "omega": np.ones(2)}).tolist() == [15.0, 15.0]


@pytest.mark.parametrize(
    "text", ["(" * 19 + "a" + ")" * 19, "-" * 38 + "a", "a" + "**2" * 38, "sin(" * 19 + "a" + ")" * 19]
)
def test_the_deepest_expressions_are_read_and_deeper_ones_are_not(text: str) -> None:
    """A parenthesis counts twice, for itself and for what is in it; a sign and a power count once."""
    assert parse(text, NAMES).names == {"a"}
    with pytest.raises(ExpressionError, match="nested more than 40 deep"):
        parse(f"-({text})", NAMES)


def test_spelling_aside_expressions_are_equal() -> None:
    assert parse("2*zeta * ( 1+mu )", ("zeta", "mu")) == parse("2.0 * zeta*(1 + mu)", ("zeta", "mu"))


def test_the_longest_expression_is_pickled_and_evaluated() -> None:
    expression = parse("1" + "+a" * ((MAX_LENGTH - 1) // 2), NAMES)
    arrays = {name: np.ones(2) for name in NAMES}
    assert pickle.loads(pickle.dumps(expression))(arrays)[0] == 250.0


@pytest.mark.parametrize("text", ["a" + "+a" * 249, "1" + "*1" * 249, "1e15" + "-1e15" * 99, "a+" * 149 + "a"])
def test_the_normal_form_of_an_expression_is_that_expression(text: str) -> None:
    """As stores have it: one of up to 500 characters may be longer there."""
    expression = parse(text, NAMES)
    assert len(text) <= MAX_LENGTH < len(expression.text)
    assert parse(expression.text, NAMES) == expression


def test_a_longer_text_is_refused_in_its_normal_form_too() -> None:
    with pytest.raises(ExpressionError, match=f"found 1001 characters, must be at most {MAX_LENGTH}"):
        parse("a" + " + a" * 250, NAMES)
