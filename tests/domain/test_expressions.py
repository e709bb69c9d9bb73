"""Expressions over telemetry: the grammar, kinds of values, and unknown results with their reason."""

from __future__ import annotations

import math
import random

import pytest

from gss.domain.errors import BadInput
from gss.domain.expression_parser import DEEPEST, Quantity
from gss.domain.expressions import MAX_CHARACTERS, Evaluation, ValueKind, parse

KINDS: dict[str, ValueKind] = {"hk.t": "number", "hk.n": "number", "hk.on": "bool", "hk.mode": "text"}
VALUES: dict[str, Quantity | None] = {"hk.t": 20.5, "hk.n": 4, "hk.on": True, "hk.mode": "idle"}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3", 7.0),
        ("(1 + 2) * 3", 9.0),
        ("8 / 4 / 2", 1.0),
        ("5 - 3 - 1", 1.0),
        ("--2 - -3", 5.0),
        ("2e3 + .5", 2000.5),
        ("hk.t * 1.8 + 32", 68.9),
        ("sqrt(hk.n) + abs(-2)", 4.0),
        ("min(3, hk.n, 1) + max(3, hk.n)", 5.0),
        ("hk.t < 40 and hk.on", True),
        ("not hk.on or hk.n >= 4", True),
        ("not not hk.on", True),
        ('hk.mode == "idle"', True),
        ("hk.mode != 'idle'", False),
        ("hk.on == true", True),
        ("1 < 2 == true", None),
    ],
)
def test_expressions_have_the_usual_precedence(text: str, value: float | bool | None) -> None:
    """Precedence is signs, products, sums, comparisons, not, and, or. Chained comparisons are rejected."""
    if value is None:
        with pytest.raises(BadInput, match="cannot be chained"):
            parse(text)
        return
    value_found = parse(text).value(VALUES).value
    assert value_found == pytest.approx(value)
    assert isinstance(value_found, bool) == isinstance(value, bool)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1 / (hk.n - 4)", "division by zero"),
        ("hk.missing + 1", "hk.missing has no current value"),
        ("sqrt(-hk.n)", "square root of a negative number"),
        ("1e308 * 1e308", "the result is too large"),
        ("hk.t > 3 and hk.missing > 1", "hk.missing has no current value"),
        ("hk.nan + 1", "hk.nan has no current value"),
    ],
)
def test_what_cannot_be_computed_is_unknown_with_a_reason(text: str, reason: str) -> None:
    """Evaluation returns no value and states the reason; it raises no exception."""
    assert parse(text).value({**VALUES, "hk.nan": math.nan}) == Evaluation(None, reason)


def test_one_operand_decides_if_it_suffices() -> None:
    """``unknown and false`` is false; ``unknown or true`` is true."""
    assert parse("hk.missing > 1 and hk.t < 0").value(VALUES) == Evaluation(False)
    assert parse("hk.missing > 1 or hk.t > 0").value(VALUES) == Evaluation(True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("1 +", "position 4; expected a number"),
        ("1 2", "position 3; expected an operator"),
        ("__import__('os')", "position 1; expected packet.field"),
        ("hk.t.real", "unexpected character at position 5"),
        ("hk.t ** 2", "position 7"),
        ("hk.t = 2", "unexpected character at position 6"),
        ("(1", r"expected \); got the end"),
        ("sqrt(1, 2)", "wrong number of arguments; expected 1; got 2"),
        ("max(1)", "expected 2 – 20; got 1"),
        ("and", "position 1"),
        ("1; 2", "unexpected character at position 2; .* got ;"),
        ("(" * (DEEPEST + 5) + "1", "at most 30 nested"),
        ("-" * (DEEPEST + 5) + "1", "at most 30 signs"),
        ("not " * (DEEPEST + 5) + "1", "at most 30 signs"),
        ("1 + " * MAX_CHARACTERS + "1", "too long"),
    ],
)
def test_invalid_text_is_rejected_with_its_position(text: str, words: str) -> None:
    """The message states the position, what was expected and what was found."""
    with pytest.raises(BadInput) as caught:
        parse(text)
    import re

    assert re.search(words, str(caught.value)), str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hk.t + hk.on", "operands of \\+ at position 6"),
        ("hk.t and hk.on", "operands of and"),
        ("-hk.mode", "operands of -"),
        ("hk.mode < 'x'", "operands of <"),
        ("hk.mode == 3", "text and number"),
        ("other.t", "unknown telemetry field"),
    ],
)
def test_kinds_are_checked_before_a_value_arrives(text: str, words: str) -> None:
    """An expression that could never be computed is rejected when it is defined."""
    with pytest.raises(BadInput, match=words):
        parse(text).kind(KINDS)


def test_the_kind_of_a_result_and_its_references() -> None:
    """The kind of the result is derived from the expression. Each referenced field is listed once, in order."""
    expression = parse("hk.t > hk.n or hk.t < 0")
    assert (expression.kind(KINDS), [str(r) for r in expression.references]) == ("bool", ["hk.t", "hk.n"])
    assert (parse("hk.t").kind(KINDS), parse("'a'").kind(KINDS)) == ("number", "text")


def test_random_arithmetic_agrees_with_python() -> None:
    """Arithmetic with constants gives the same value as Python's evaluation of the same text."""
    random.seed(7)
    for _ in range(500):
        parts = [f"{random.uniform(0.5, 9):.3f}"]
        for _ in range(random.randint(1, 8)):
            parts += [random.choice("+-*/"), f"{random.choice(['', '-'])}{random.uniform(0.5, 9):.3f}"]
        if random.random() < 0.5 and len(parts) > 3:
            parts[0], parts[2] = f"({parts[0]}", f"{parts[2]})"
        text = " ".join(parts)
        assert parse(text).value({}).value == pytest.approx(eval(text)), text  # noqa: S307 - text generated here


def test_random_text_gives_a_value_or_bad_input() -> None:
    """Random text is evaluated or rejected with ``BadInput``; it causes no other exception."""
    random.seed(8)
    pieces = [
        "1",
        "hk.t",
        "(",
        ")",
        "+",
        "-",
        "*",
        "/",
        "and",
        "or",
        "not",
        "<",
        "==",
        "min",
        "sqrt",
        ",",
        " ",
        "'a'",
        "$",
        "é",
    ]
    for _ in range(5000):
        text = " ".join(random.choices(pieces, k=random.randint(1, 14)))
        try:
            parse(text).value(VALUES)
        except BadInput:
            continue
