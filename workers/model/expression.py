"""Arithmetic expressions of named numbers: read by a parser of their own, evaluated on arrays by numpy alone.

    expression = term, then any of + term, - term
    term       = factor, then any of * factor, / factor
    factor     = - factor, + factor, or atom, atom ** factor
    atom       = a number, a name, pi, function(expression, ...), (expression)

with the precedence that Python gives them: -x**2 is -(x**2), and 2**3**2 is 2**(3**2). Nothing else can be written, so
that nothing else can happen: what an expression from a stranger's file costs is bounded by its length.
"""

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
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

_BINARY: dict[str, Callable[..., Any]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "**": np.power,
}  # fmt: skip
_TOKEN = re.compile(
    r"[ \t\r\n]*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z_][A-Za-z_0-9]*)|(\*\*|[-+*/(),]))", re.ASCII
)
_NUMBER, _NAME, _CALL, _SIGN, _TIMES_ITSELF = range(5)


class ExpressionError(ValueError):
    """What is wrong with an expression, in one line."""


class Step(NamedTuple):
    """What is done next with a stack of arrays: push a number or a name's value, or replace the top ones by a result.

    kind    _NUMBER, _NAME, _CALL of a function or an operator, _SIGN: the other sign, or _TIMES_ITSELF: a whole power
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
        (first, *more) = self.steps
        return first.value if first.kind == _NUMBER and not more else None

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
            elif kind == _SIGN:
                stack.append(np.negative(stack.pop()))
            elif kind == _TIMES_ITSELF:
                stack.append(_whole_power(stack.pop(), int(value)))
            elif what in _BINARY:
                right, left = stack.pop(), stack.pop()
                stack.append(_BINARY[what](left, right))
            else:
                act, arguments = FUNCTIONS[what][0], [stack.pop() for _ in range(int(value))][::-1]
                result = arguments[0] if len(arguments) > 1 else act(arguments[0])
                for other in arguments[1:]:
                    result = act(result, other)
                stack.append(result)
        return np.asarray(stack.pop(), dtype=np.float64)


def constant(value: float) -> Expression:
    """The expression that is a number."""
    return Expression(repr(value), (Step(_NUMBER, "", value),))


def parse(text: str, known: Collection[str]) -> Expression:
    """The expression that a text is, of names that are known; ExpressionError otherwise."""
    if len(text) > LONGEST:
        raise ExpressionError(f"found {len(text)} characters, must be at most {LONGEST}")
    tokens = _tokens(text)
    reader = _Reader(tokens, known)
    reader.expression()
    if reader.place < len(tokens):
        raise ExpressionError(f"found {tokens[reader.place]!r} after {tokens[reader.place - 1]!r}, must be an operator")
    written = [repr(float(token)) if _is_number(token) else token for token in tokens]
    return Expression(" ".join(written), tuple(reader.steps))


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


def _is_number(token: str) -> bool:
    return token[0].isdigit() or token[0] == "."


def _tokens(text: str) -> list[str]:
    text = text.rstrip(" \t\r\n")
    found, place = [], 0
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None:
            sign = text[place:].lstrip(" \t\r\n")[0]
            raise ExpressionError(f"found {sign!r}, must be numbers, names, + - * / **, parentheses and commas")
        found.append(match.group(match.lastindex or 0))
        place = match.end()
    return found


class _Reader:
    """Tokens to steps, by one method for each line of the grammar."""

    def __init__(self, tokens: list[str], known: Collection[str]) -> None:
        self.tokens, self.known = tokens, known
        self.place = self.depth = 0
        self.steps: list[Step] = []

    def next_is(self, *tokens: str) -> str:
        """The next token, passed over, if it is one of these; else an empty text."""
        if self.place < len(self.tokens) and self.tokens[self.place] in tokens:
            self.place += 1
            return self.tokens[self.place - 1]
        return ""

    def expression(self) -> None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise ExpressionError(f"nested more than {DEEPEST} deep")
        self.term()
        while operator := self.next_is("+", "-"):
            self.term()
            self.steps.append(Step(_CALL, operator, 2))
        self.depth -= 1

    def term(self) -> None:
        self.factor()
        while operator := self.next_is("*", "/"):
            self.factor()
            self.steps.append(Step(_CALL, operator, 2))

    def factor(self) -> None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise ExpressionError(f"nested more than {DEEPEST} deep")
        if sign := self.next_is("+", "-"):
            begin = len(self.steps)
            self.factor()
            if sign == "-":
                alone = len(self.steps) == begin + 1 and self.steps[begin].kind == _NUMBER
                self.steps[begin:] = (
                    [Step(_NUMBER, "", -self.steps[begin].value)]
                    if alone
                    else [*self.steps[begin:], Step(_SIGN, "", 1)]
                )
        else:
            self.atom()
            if self.next_is("**"):
                self.power()
        self.depth -= 1

    def power(self) -> None:
        begin = len(self.steps)
        self.factor()
        exponent = self.steps[begin]
        whole = exponent.kind == _NUMBER and abs(exponent.value) <= LARGEST_POWER and exponent.value.is_integer()
        if len(self.steps) == begin + 1 and whole:
            self.steps[begin] = Step(_TIMES_ITSELF, "", exponent.value)
        else:
            self.steps.append(Step(_CALL, "**", 2))

    def atom(self) -> None:
        if self.place == len(self.tokens):
            where = f"after {self.tokens[-1]!r}" if self.tokens else "at all"
            raise ExpressionError(f"found nothing {where}, must be a number, a name or a parenthesis")
        token = self.tokens[self.place]
        self.place += 1
        if token == "(":
            self.expression()
            self.close()
        elif _is_number(token):
            if not math.isfinite(float(token)):
                raise ExpressionError("found a number beyond the range of double precision")
            self.steps.append(Step(_NUMBER, "", float(token)))
        elif not (token[0].isalpha() or token[0] == "_"):
            raise ExpressionError(f"found {token!r}, must be a number, a name or a parenthesis")
        elif self.next_is("("):
            self.call(token)
        elif token == PI:
            self.steps.append(Step(_NUMBER, "", math.pi))
        elif token in self.known:
            self.steps.append(Step(_NAME, token, 0))
        else:
            raise ExpressionError(unknown_name("name", token, [*self.known, PI]))

    def call(self, name: str) -> None:
        if name not in FUNCTIONS:
            raise ExpressionError(unknown_name("function", name, FUNCTIONS))
        count = 1
        self.expression()
        while self.next_is(","):
            self.expression()
            count += 1
        self.close()
        _, least, most = FUNCTIONS[name]
        if not least <= count <= most:
            wanted = "1 argument" if most == 1 else f"{least} to {most} arguments"
            raise ExpressionError(f"found {name} of {count}, must be of {wanted}")
        self.steps.append(Step(_CALL, name, count))

    def close(self) -> None:
        if not self.next_is(")"):
            found = repr(self.tokens[self.place]) if self.place < len(self.tokens) else "the end"
            raise ExpressionError(f"found {found}, must be a closing parenthesis")
