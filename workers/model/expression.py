"""Arithmetic expressions of named numbers: checked token by token, parsed by Python, evaluated by numpy alone.

    expression = term, then any of + term, - term
    term       = factor, then any of * factor, / factor
    factor     = - factor, + factor, or atom, atom ** factor
    atom       = a number, a name, pi, function(expression, ...), (expression)

The precedence is Python's: -x**2 is -(x**2), and 2**3**2 is 2**(3**2). The grammar admits nothing else, so the length
of an expression from an untrusted file bounds its cost.
"""

import ast
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce
from itertools import pairwise
from typing import Any

import numpy as np

from workers.model.oscillator import Array
from workers.model.parameter import OMEGA, PHASE, near_name, unknown_name

MAX_LENGTH = 500
"""Maximum length of an expression, in characters."""
LONGEST_NORMAL = 20 * MAX_LENGTH
"""Maximum length of a normal form. A number of one character takes four with its blank, one such as 1e15 takes 19."""
DEEPEST = 40
"""Maximum depth of nested parentheses, signs and powers."""
MAX_INTEGER_POWER = 16
"""Largest integer exponent computed as a product, which every computer rounds in the same way."""

PI = "pi"
FUNCTIONS: dict[str, tuple[Callable[..., Any], int, int]] = {
    "sqrt": (np.sqrt, 1, 1), "sin": (np.sin, 1, 1), "cos": (np.cos, 1, 1), "tan": (np.tan, 1, 1),
    "exp": (np.exp, 1, 1), "log": (np.log, 1, 1), "abs": (np.abs, 1, 1),
    "atan2": (np.arctan2, 2, 2), "min": (np.minimum, 2, 8), "max": (np.maximum, 2, 8),
}  # fmt: skip
"""Functions, with the minimum and maximum number of arguments."""
RESERVED = (PI, *FUNCTIONS)
"""Names reserved for expressions."""
_TIME = ("t", "time")

_BINARY: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power,
}  # fmt: skip
_TOKEN = re.compile(
    r"((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_][A-Za-z_0-9]*|\*\*|[-+*/(),])|[ \t\r\n]+|(.)", re.ASCII | re.DOTALL
)


class ExpressionError(ValueError):
    """Error of an expression, in one line."""


@dataclass(frozen=True)
class Expression:
    """An expression, as text in a normal form (for a number its repr): comparable, hashable, picklable."""

    text: str

    @property
    def names(self) -> set[str]:
        """Names that the expression uses."""
        return {node.id[1:] for node in ast.walk(_tree(self.text)) if isinstance(node, ast.Name)}.difference(RESERVED)

    @cached_property
    def constant(self) -> float | None:
        """Value of a single number, without names or operations; None for any other expression."""
        return _constant(_tree(self.text))

    def __call__(self, values: Mapping[str, Array]) -> Array:
        """Return the values (N,) of the expression at values (N,) of each name, which must include ``omega``.

        Division by zero or a root of a negative number gives infinity or NaN, as in numpy. Each of the N results
        depends on its own values only.
        """
        return np.asarray(_value(_tree(self.text), values), dtype=np.float64)


Row = tuple[Expression, ...]
Matrix = tuple[Row, ...]


def evaluate_entries(entries: Any, named: Mapping[str, Array]) -> Array:
    """Return the values of an expression (N,), or of a row (N, n) or matrix (N, n, n) of expressions and numbers.

    ``named`` has values (N,) by name.
    """
    if isinstance(entries, Expression):
        return entries(named)
    numbers, others = (_kept if isinstance(entries, tuple) else _sorted)(entries)
    values = np.empty((named[OMEGA].size, *numbers.shape))
    values[...] = numbers
    for index, expression in others:
        values[:, *index] = expression(named)
    return values


def _sorted(entries: Any) -> tuple[Array, list[tuple[Any, Expression]]]:
    """Return (numbers, others): the numbers of a row or matrix, and its expressions with names, each with its index.

    The numbers are zero where there is an expression with names or operations.
    """
    grid = np.array(entries, dtype=object)
    numbers, others = np.zeros(grid.shape), []
    for index, entry in np.ndenumerate(grid):
        number = entry.constant if isinstance(entry, Expression) else entry
        if number is None:
            others.append((index, entry))
        else:
            numbers[index] = number
    return numbers, others


_kept = lru_cache(maxsize=1024)(_sorted)


def parse(text: str, known: Collection[str]) -> Expression:
    """Return the expression of a text with known names; raise ExpressionError if the text is no expression.

    The normal form of an expression is an expression too, although it may be longer than MAX_LENGTH.
    """
    tokens = _tokens(text) if len(text) <= LONGEST_NORMAL else []
    normal = " ".join(repr(float(token)) if _is_number(token) else token for token in tokens)
    if len(text) > MAX_LENGTH and (text != normal or len(tokens) > MAX_LENGTH):
        raise ExpressionError(f"found {len(text)} characters, must be at most {MAX_LENGTH}")
    _check_order(tokens)
    expression = Expression(normal)
    _check_names(_tree(expression.text), known)
    return expression


@lru_cache(maxsize=4096)
def _tree(text: str) -> ast.expr:
    """Return Python's tree of a normal form.

    Names get an underscore, since no keyword begins with one: a parameter may be called lambda.
    """
    return ast.parse(re.sub(r"\b(?=[A-Za-z_])", "_", text), mode="eval").body


def _constant(node: ast.expr) -> float | None:
    match node:
        case ast.Constant(value=float(value)):
            return value
        case ast.Name(id="_pi"):
            return math.pi
        case ast.UnaryOp(op=sign, operand=operand):
            number = _constant(operand)
            return -number if number is not None and isinstance(sign, ast.USub) else number
    return None


def _value(node: ast.expr, values: Mapping[str, Array]) -> Any:
    if (number := _constant(node)) is not None:
        return np.full(values[OMEGA].shape, number)
    match node:
        case ast.Name(id=name):
            return values[name[1:]]
        case ast.UnaryOp(op=sign, operand=operand):
            return np.negative(_value(operand, values)) if isinstance(sign, ast.USub) else _value(operand, values)
        case ast.BinOp(left=left, op=operator, right=right):
            power = _constant(right) if isinstance(operator, ast.Pow) else None
            if power is not None and abs(power) <= MAX_INTEGER_POWER and power.is_integer():
                return _whole_power(_value(left, values), int(power))
            return _BINARY[type(operator)](_value(left, values), _value(right, values))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            act, operands = FUNCTIONS[name[1:]][0], [_value(argument, values) for argument in arguments]
            return reduce(act, operands) if len(operands) > 1 else act(*operands)
    raise AssertionError(node)


def _whole_power(base: Array, exponent: int) -> Array:
    """Return base ** exponent by multiplication, from the highest binary digit of the exponent on.

    For a negative exponent it is the inverse of the positive power.
    """
    if exponent == 0:
        return np.ones_like(base)
    result = base
    for digit in bin(abs(exponent))[3:]:
        result = result * result
        if digit == "1":
            result = result * base
    return 1.0 / result if exponent < 0 else result


def _tokens(text: str) -> list[str]:
    matches = _TOKEN.findall(text)
    for _, other in matches:
        if other:
            raise ExpressionError(f"found {other!r}, must be numbers, names, + - * / **, parentheses and commas")
    return [token for token, _ in matches if token]


def _is_number(token: str) -> bool:
    return token[:1].isdigit() or token[:1] == "."


def _check_order(tokens: list[str]) -> None:
    """Raise ExpressionError at the first misplaced token, or if the nesting is too deep.

    Python syntax beyond the grammar is rejected, such as (a, b), f(*a), f(a,) and (f)(a).
    """
    groups = [""]  # open parentheses: the function of each, the whole expression first
    depths = [2]  # of each: its own depth, its present operand, and the signs and powers around that operand
    for before, token in pairwise(["(", *tokens, ""]):
        if before in ("(", ",", "+", "-", "*", "/", "**"):
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


def _unknown(name: str, known: list[str]) -> str:
    """Return the one-line error message for an unknown name: the nearest known name, or what an entry may contain."""
    if name == PHASE:
        return (
            f"unknown name {name!r}; only stiffness, damping, load and constants of soft contacts and friction may be "
            f"expressions of it, beside within = ERROR in [system]"
        )
    if name not in _TIME and near_name(name, known):
        return unknown_name("name", name, known)
    force = "; a force is an amplitude, which sin(omega t + tau) multiplies by itself" if name in _TIME else ""
    return f"unknown name {name!r}; an entry knows neither time nor state, only {', '.join(known)}{force}"


def _check_names(tree: ast.expr, known: Collection[str]) -> None:
    """Raise ExpressionError at the first unknown name, or wrong number of arguments."""
    nodes = list(ast.walk(tree))
    arguments = {node.func: len(node.args) for node in nodes if isinstance(node, ast.Call)}
    names = [node for node in nodes if isinstance(node, ast.Name)]
    for node in sorted(names, key=lambda node: node.col_offset):
        name, count = node.id[1:], arguments.get(node)
        if count is None:
            if name not in (PI, *known):
                raise ExpressionError(_unknown(name, [*known, PI]))
            continue
        if name not in FUNCTIONS:
            raise ExpressionError(unknown_name("function", name, FUNCTIONS))
        _, least, most = FUNCTIONS[name]
        if not least <= count <= most:
            expected = f"{most} argument" + "s" * (most > 1) if least == most else f"{least} to {most} arguments"
            raise ExpressionError(f"found {name} with {count}, must have {expected}")
