"""Arithmetic expressions of named numbers: checked token by token, read by Python's parser, evaluated by numpy alone.

    expression = term, then any of + term, - term
    term       = factor, then any of * factor, / factor
    factor     = - factor, + factor, or atom, atom ** factor
    atom       = a number, a name, pi, function(expression, ...), (expression)

with the precedence that Python gives them: -x**2 is -(x**2), and 2**3**2 is 2**(3**2). Nothing else can be written, so
that nothing else can happen: what an expression from a stranger's file costs is bounded by its length.
"""

import ast
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.parameter import OMEGA, unknown_name

Array = NDArray[np.float64]

LONGEST = 500
"""Characters of an expression."""
DEEPEST = 40
"""Parentheses, signs and powers within each other."""
LARGEST_POWER = 16
"""Whole exponents up to which a power is a product, rounded alike wherever it is computed."""

PI = "pi"
FUNCTIONS: dict[str, tuple[Callable[..., Any], int, int]] = {
    "sqrt": (np.sqrt, 1, 1), "sin": (np.sin, 1, 1), "cos": (np.cos, 1, 1), "tan": (np.tan, 1, 1),
    "exp": (np.exp, 1, 1), "log": (np.log, 1, 1), "abs": (np.abs, 1, 1),
    "min": (np.minimum, 2, 8), "max": (np.maximum, 2, 8),
}  # fmt: skip
"""Each with the least and the largest number of arguments."""
RESERVED = (PI, *FUNCTIONS)
"""Names that no parameter may have."""

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "**": np.power, "sign": np.negative,
} | {name: act for name, (act, _, _) in FUNCTIONS.items()}  # fmt: skip
_BINARY: dict[type[ast.operator], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_TOKEN = re.compile(
    r"((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_][A-Za-z_0-9]*|\*\*|[-+*/(),])|[ \t\r\n]+|(.)", re.ASCII | re.DOTALL
)
_NUMBER, _NAME, _CALL, _WHOLE_POWER = range(4)


class ExpressionError(ValueError):
    """What is wrong with an expression, in one line."""


class Step(NamedTuple):
    """What is done next with a stack of arrays: push a number or a name's value, or replace the top ones by a result.

    kind    _NUMBER, _NAME, _CALL of a function or an operator, or _WHOLE_POWER: a product
    what    the name, the function or the operator
    value   the number; how many arguments; the exponent
    """

    kind: int
    what: str
    value: float


@dataclass(frozen=True)
class Expression:
    """An expression as its text in a uniform spelling and as the steps of its evaluation, operands first.

    It holds no code and no objects but text and numbers: it can be compared, hashed, pickled.
    """

    text: str
    steps: tuple[Step, ...]

    @property
    def names(self) -> set[str]:
        """The names whose values it takes."""
        return {step.what for step in self.steps if step.kind == _NAME}

    @property
    def constant(self) -> float | None:
        """Its value where it is one number, and no name or operation; else None."""
        return _constant(self.steps)

    def __call__(self, values: Mapping[str, Array]) -> Array:
        """Its values (N,) for the values (N,) of each name, ``omega`` among them.

        Infinite or NaN where double precision has no other answer, as numpy does: division by zero, a root of a
        negative number. What one element gives does not depend on the others.
        """
        shape = values[OMEGA].shape
        stack: list[Any] = []
        for kind, what, value in self.steps:
            if kind == _NUMBER:
                stack.append(np.full(shape, value))
            elif kind == _NAME:
                stack.append(values[what])
            elif kind == _WHOLE_POWER:
                stack.append(_whole_power(stack.pop(), int(value)))
            else:
                act, arguments = _OPERATIONS[what], [stack.pop() for _ in range(int(value))][::-1]
                stack.append(reduce(act, arguments) if len(arguments) > 1 else act(*arguments))
        return np.asarray(stack.pop(), dtype=np.float64)


def constant(value: float) -> Expression:
    """The expression that is a number."""
    return Expression(repr(value), (Step(_NUMBER, "", value),))


def parse(text: str, known: Collection[str]) -> Expression:
    """The expression that a text is, of names that are known; ExpressionError otherwise."""
    if len(text) > LONGEST:
        raise ExpressionError(f"found {len(text)} characters, must be at most {LONGEST}")
    tokens = _tokens(text)
    _check(tokens)
    written = [repr(float(token)) if _is_number(token) else token for token in tokens]
    # No keyword of Python begins with an underscore: a parameter may be called lambda.
    python = " ".join(f"_{token}" if token.isidentifier() else token for token in written)
    return Expression(" ".join(written), tuple(_steps(ast.parse(python, mode="eval").body, known)))


def _whole_power(base: Array, exponent: int) -> Array:
    """base ** exponent by multiplication, from the highest binary digit of the exponent on; 1 / that if negative."""
    if exponent == 0:
        return np.ones_like(base)
    result = base
    for digit in bin(abs(exponent))[3:]:
        result = result * result
        if digit == "1":
            result = result * base
    return 1.0 / result if exponent < 0 else result


def _tokens(text: str) -> list[str]:
    found = []
    for token, other in _TOKEN.findall(text):
        if other:
            raise ExpressionError(f"found {other!r}, must be numbers, names, + - * / **, parentheses and commas")
        if token:
            found.append(token)
    return found


def _is_number(token: str) -> bool:
    return token[:1].isdigit() or token[:1] == "."


def _check(tokens: list[str]) -> None:
    """ExpressionError at the first token that cannot stand where it does, or that is nested too deeply.

    What Python has beyond the grammar, such as (a, b), f(*a), f(a,) and (f)(a), is refused here.
    """
    groups = [""]  # of parentheses that are open: the function that they belong to, the whole first
    depths = [2]  # of each: itself, its present operand, and the signs and powers that this one is in
    for before, token in pairwise(["(", *tokens, ""]):
        if before in ("(", ",", *_BINARY.values()):
            if not token:
                where = f"after {before!r}" if tokens else "at all"
                raise ExpressionError(f"found nothing {where}, must be a number, a name or a parenthesis")
            if token in (")", ",", "*", "/", "**"):
                raise ExpressionError(f"found {token!r}, must be a number, a name or a parenthesis")
            if _is_number(token) and not math.isfinite(float(token)):
                raise ExpressionError("found a number beyond the range of double precision")
            depths[-1] += token in ("+", "-")
        elif token in ("+", "-", "*", "/") or (token == "," and groups[-1]):
            depths[-1] = 2
        elif token == "**":
            depths[-1] += 1
        elif token == ")" and len(groups) > 1:
            groups.pop(), depths.pop()
        elif not token and len(groups) > 1:
            raise ExpressionError("found the end, must be a closing parenthesis")
        elif token and not (token == "(" and before.isidentifier()):
            raise ExpressionError(f"found {token!r} after {before!r}, must be an operator")
        if token == "(":
            groups.append(before if before.isidentifier() else "")
            depths.append(2)
        if sum(depths) > DEEPEST:
            raise ExpressionError(f"nested more than {DEEPEST} deep")


def _steps(node: ast.expr, known: Collection[str]) -> list[Step]:
    """The steps of a tree; down the left sides of operators without recursion, as a sum of 250 terms leans that way."""
    operators: list[ast.BinOp] = []
    while isinstance(node, ast.BinOp):
        operators.append(node)
        node = node.left
    found = _operand(node, known)
    for each in reversed(operators):
        right = _steps(each.right, known)
        power = _constant(right) if isinstance(each.op, ast.Pow) else None
        if power is not None and abs(power) <= LARGEST_POWER and power.is_integer():
            found.append(Step(_WHOLE_POWER, "", power))
        else:
            found += [*right, Step(_CALL, _BINARY[type(each.op)], 2)]
    return found


def _constant(steps: Sequence[Step]) -> float | None:
    return steps[0].value if len(steps) == 1 and steps[0].kind == _NUMBER else None


def _operand(node: ast.expr, known: Collection[str]) -> list[Step]:
    match node:
        case ast.Constant(value=float(value)):
            return [Step(_NUMBER, "", value)]
        case ast.Name(id=name):
            return [_named(name[1:], known)]
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _steps(operand, known)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            steps = _steps(operand, known)
            number = _constant(steps)
            return [*steps, Step(_CALL, "sign", 1)] if number is None else [Step(_NUMBER, "", -number)]
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            call = _call(name[1:], len(arguments))
            return [*(step for argument in arguments for step in _steps(argument, known)), call]
    raise ExpressionError(f"found {type(node).__name__}, must be arithmetic")


def _named(name: str, known: Collection[str]) -> Step:
    if name == PI:
        return Step(_NUMBER, "", math.pi)
    if name not in known:
        raise ExpressionError(unknown_name("name", name, [*known, PI]))
    return Step(_NAME, name, 0)


def _call(name: str, count: int) -> Step:
    if name not in FUNCTIONS:
        raise ExpressionError(unknown_name("function", name, FUNCTIONS))
    _, least, most = FUNCTIONS[name]
    if not least <= count <= most:
        wanted = "1 argument" if most == 1 else f"{least} to {most} arguments"
        raise ExpressionError(f"found {name} of {count}, must be of {wanted}")
    return Step(_CALL, name, count)
