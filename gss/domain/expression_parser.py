"""Parser that converts the text of an expression to a tree of nodes. ``expressions`` contains the grammar."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

from gss.domain.errors import BadInput

Quantity = float | int | bool | str
DEEPEST = 30
"""Maximum nesting depth of parentheses, signs and ``not``."""
TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<text>\"[^\"]*\"|'[^']*')"
    r"|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?)|(?P<sign><=|>=|==|!=|[-+*/<>(),]))"
)
ARITHMETIC: Mapping[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
COMPARISONS: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
FUNCTIONS: Mapping[str, tuple[int, int, Callable[[Sequence[float]], float]]] = {
    "abs": (1, 1, lambda x: abs(x[0])),
    "sqrt": (1, 1, lambda x: math.sqrt(x[0])),
    "min": (2, 20, min),
    "max": (2, 20, max),
}
"""Function name to (minimum number of arguments, maximum number of arguments, function)."""


@dataclass(frozen=True)
class FieldReference:
    """Reference to a telemetry field. Its text ``packet.field`` is the key in mappings of values."""

    packet: str
    field: str

    def __str__(self) -> str:
        return f"{self.packet}.{self.field}"


@dataclass(frozen=True)
class ConstantNode:
    value: Quantity


@dataclass(frozen=True)
class CallNode:
    """An operator or function with its operands. ``at``: index of its first character in the text."""

    name: str
    operands: tuple[ExpressionNode, ...]
    at: int


ExpressionNode = ConstantNode | FieldReference | CallNode


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    at: int


def _tokens(text: str) -> list[_Token]:
    tokens, at = [], 0
    while text[at:].strip():
        token_match = TOKEN.match(text, at)
        if token_match is None:
            unread = text[at:].lstrip()
            raise BadInput(
                f"The expression has an unexpected character at position {len(text) - len(unread) + 1}",
                expected="numbers, packet.field, + - * / < <= > >= == != and or not ( )",
                got=unread[0],
            )
        kind = str(token_match.lastgroup)
        tokens.append(_Token(kind, token_match.group(kind), token_match.start(kind)))
        at = token_match.end()
    return tokens


class ExpressionParser:
    """Recursive-descent parser with one method per grammar rule."""

    def __init__(self, text: str) -> None:
        self._tokens, self._next, self._depth = [*_tokens(text), _Token("end", "", len(text))], 0, 0
        self.references: list[FieldReference] = []

    def whole(self) -> ExpressionNode:
        root = self._or()
        if self._token.kind != "end":
            self._fail("an operator or the end")
        return root

    @property
    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _fail(self, expected: str) -> NoReturn:
        raise BadInput(
            f"The expression has an error at position {self._token.at + 1}",
            expected=expected,
            got=self._token.text or "the end",
        )

    def _takes(self, *texts: str) -> _Token | None:
        token = self._token
        if token.kind in ("sign", "name") and token.text in texts:
            self._next += 1
            return token
        return None

    def _needs(self, text: str) -> None:
        if not self._takes(text):
            self._fail(text)

    def _joined(self, operand: Callable[[], ExpressionNode], *names: str) -> ExpressionNode:
        left = operand()
        while token := self._takes(*names):
            left = CallNode(token.text, (left, operand()), token.at)
        return left

    def _or(self) -> ExpressionNode:
        self._depth += 1
        if self._depth > DEEPEST:
            self._fail(f"at most {DEEPEST} nested parentheses")
        node = self._joined(self._and, "or")
        self._depth -= 1
        return node

    def _and(self) -> ExpressionNode:
        return self._joined(self._not, "and")

    def _not(self) -> ExpressionNode:
        return self._prefixed("not", "not", self._comparison)

    def _comparison(self) -> ExpressionNode:
        left = self._sum()
        if token := self._takes(*COMPARISONS):
            left = CallNode(token.text, (left, self._sum()), token.at)
            if self._token.text in COMPARISONS:
                self._fail("and or or: comparisons cannot be chained")
        return left

    def _sum(self) -> ExpressionNode:
        return self._joined(self._product, "+", "-")

    def _product(self) -> ExpressionNode:
        return self._joined(self._sign, "*", "/")

    def _sign(self) -> ExpressionNode:
        return self._prefixed("-", "negative", self._atom)

    def _prefixed(self, sign: str, name: str, operand: Callable[[], ExpressionNode]) -> ExpressionNode:
        signs = []
        while token := self._takes(sign):
            signs.append(token)
            if len(signs) > DEEPEST:
                self._fail(f"at most {DEEPEST} signs")
        node = operand()
        for token in reversed(signs):
            node = CallNode(name, (node,), token.at)
        return node

    def _atom(self) -> ExpressionNode:
        token = self._token
        if self._takes("("):
            node = self._or()
            self._needs(")")
            return node
        if token.kind not in ("number", "text", "name"):
            self._fail("a number, packet.field, a function or (")
        if token.kind == "name" and token.text in ("and", "or", "not"):
            self._fail("a number, packet.field, a function or (")
        self._next += 1
        if token.kind == "number":
            return ConstantNode(float(token.text))
        if token.kind == "text":
            return ConstantNode(token.text[1:-1])
        return self._named(token)

    def _named(self, token: _Token) -> ExpressionNode:
        if token.text in ("true", "false"):
            return ConstantNode(token.text == "true")
        if token.text in FUNCTIONS:
            return self._function(token)
        packet, dot, field = token.text.partition(".")
        if not dot:
            self._next -= 1
            self._fail(f"packet.field, or one of {', '.join(FUNCTIONS)}; text is written in quotes")
        reference = FieldReference(packet, field)
        self.references.append(reference)
        return reference

    def _function(self, token: _Token) -> ExpressionNode:
        self._needs("(")
        operands = [self._or()]
        while self._takes(","):
            operands.append(self._or())
        self._needs(")")
        minimum, maximum, _ = FUNCTIONS[token.text]
        if not minimum <= len(operands) <= maximum:
            raise BadInput(
                f"The function {token.text} at position {token.at + 1} has a wrong number of arguments",
                expected=str(minimum) if minimum == maximum else f"{minimum} – {maximum}",
                got=str(len(operands)),
            )
        return CallNode(token.text, tuple(operands), token.at)
