"""Reader of procedure files. A procedure is a Markdown file. Each heading of level 2 is a step, which has at most one fenced block
with an action.

    ## cool: Cool the detector
    Text for the operator.
    ```check
    housekeeping.sensor_temperature_c < 10
    within: 60 s
    else: stop
    ```

Blocks: ``check`` (an expression; ``within:`` is the time to wait until it is true, ``else:`` the next step if it is false),
``command`` (NAME argument=value …), ``wait`` (a duration), ``question`` (the question, then ``answer: step`` lines), ``hold`` (a
statement that a second person confirms), ``sign`` (a statement that is signed) and ``branch`` (``if expression: step`` lines, then
``else: step``). A target is the name of a step, ``next`` or ``end``.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from markdown_it import MarkdownIt

from gss.domain.errors import BadInput

ActionKind = Literal["text", "check", "command", "wait", "question", "hold", "sign", "branch"]
ACTIONS: tuple[ActionKind, ...] = ("check", "command", "wait", "question", "hold", "sign", "branch")
NEXT, END = "next", "end"
HEADING = re.compile(r"(?P<id>[a-z][a-z0-9-]{0,39})\s*:\s*(?P<title>\S.*)")
OPTION = re.compile(r"(?P<name>[^:]+):\s*(?P<value>\S.*)")
DURATION = re.compile(r"(?P<number>\d+(?:\.\d+)?)\s*(?P<unit>s|min|h)")
SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}
MAX_S = 86_400.0
MAX_CHARACTERS, MAX_STEPS = 100_000, 600
_MARKDOWN = MarkdownIt("commonmark", {"html": False})


@dataclass(frozen=True)
class Mistake:
    """A mistake in a procedure. ``line``: line number, starting at 1."""

    line: int
    text: str


@dataclass(frozen=True)
class Branch:
    """A target of a step. ``when``: expression, answer or "else" that selects the target."""

    when: str
    target: str


@dataclass(frozen=True)
class ProcedureStep:
    """One step. ``words``: expression, command line, question or statement of its action. ``seconds``: duration of a wait, or the
    time for which a check waits. ``branches``: targets other than the next step. ``line``: line of its heading. ``at``: line of
    its action."""

    id: str
    title: str
    text: str
    kind: ActionKind
    line: int
    words: str = ""
    seconds: float = 0.0
    branches: tuple[Branch, ...] = ()
    at: int = 0

    def targets(self) -> tuple[str, ...]:
        """Return all possible targets of the step."""
        branch_targets = tuple(branch.target for branch in self.branches)
        return branch_targets if self.kind in ("question", "branch") else (NEXT, *branch_targets)

    def target(self, when: str) -> str:
        """Return the target of an expression or answer. Return ``next`` if the step has no branch for it."""
        return next((branch.target for branch in self.branches if branch.when == when), NEXT)


@dataclass(frozen=True)
class ProcedureDocument:
    """Content of a procedure file. ``mistakes``: parts that cannot be read. If there are any, the steps can be incomplete."""

    title: str
    introduction: str
    steps: tuple[ProcedureStep, ...]
    mistakes: tuple[Mistake, ...]

    def step(self, step_id: str) -> ProcedureStep:
        """Return the step with this id. Raises BadInput if there is none."""
        for step in self.steps:
            if step.id == step_id:
                return step
        raise BadInput("The procedure has no such step", got=step_id)

    def after(self, step: ProcedureStep, target: str) -> str | None:
        """Return the id of the step that a target of ``step`` refers to, None for the end of the procedure."""
        if target == END:
            return None
        if target != NEXT:
            return target
        index = self.steps.index(step) + 1
        return self.steps[index].id if index < len(self.steps) else None


@dataclass
class _Section:
    """A heading with the action blocks below it. ``line``: index of the first line of the section. ``end``: index of
    the line after the last."""

    heading: str
    line: int
    end: int = 0
    blocks: list[tuple[str, str, int, int]] = field(default_factory=list)
    """(kind, content, index of the first line, index of the line after the last) of each action."""


def read_procedure(text: str) -> ProcedureDocument:
    """Read a procedure. The result contains all mistakes with their lines. Raises BadInput if the text is too long."""
    if len(text) > MAX_CHARACTERS:
        raise BadInput("The procedure is too long", expected=f"at most {MAX_CHARACTERS} characters", got=str(len(text)))
    lines = text.splitlines()
    title, first, sections = _sections(text, len(lines))
    mistakes: list[Mistake] = []
    if not title:
        mistakes.append(Mistake(1, "The procedure has no title: begin it with a line “# Title”."))
    if not 1 <= len(sections) <= MAX_STEPS:
        mistakes.append(
            Mistake(1, f"The procedure has {len(sections)} steps: write 1 – {MAX_STEPS} headings “## name: Title”.")
        )
    steps = [_step(section, lines, mistakes) for section in sections[:MAX_STEPS]]
    return ProcedureDocument(title, _prose(lines, *first), tuple(steps), tuple(mistakes))


def _sections(text: str, count: int) -> tuple[str, tuple[int, int], list[_Section]]:
    """Return the title, the range of lines of the introduction, and the sections of level 2."""
    title, title_end = "", 0
    sections: list[_Section] = []
    tokens = _MARKDOWN.parse(text)
    for k, token in enumerate(tokens):
        if token.map is None or token.level != 0:
            continue
        if token.type == "heading_open" and token.tag == "h1" and not title:
            title, title_end = tokens[k + 1].content.strip(), token.map[1]
        elif token.type == "heading_open" and token.tag == "h2":
            if sections:
                sections[-1].end = token.map[0]
            sections.append(_Section(tokens[k + 1].content.strip(), token.map[0], count))
        elif token.type == "fence" and sections and token.info.strip() in ACTIONS:
            sections[-1].blocks.append((token.info.strip(), token.content, token.map[0], token.map[1]))
    return title, (title_end, sections[0].line if sections else count), sections


def _prose(lines: Sequence[str], start: int, end: int, skip: tuple[int, int] = (0, 0)) -> str:
    prose_lines = [line for k, line in enumerate(lines[start:end], start) if not skip[0] <= k < skip[1]]
    return "\n".join(prose_lines).strip()


def _step(section: _Section, lines: Sequence[str], mistakes: list[Mistake]) -> ProcedureStep:
    named = HEADING.fullmatch(section.heading)
    if named is None:
        mistakes.append(
            Mistake(section.line + 1, f"The heading “{section.heading}” is not a step: write “## name: Title”.")
        )
    step_id = named["id"] if named else f"line-{section.line + 1}"
    title = named["title"] if named else section.heading
    if step_id in (NEXT, END):
        mistakes.append(Mistake(section.line + 1, f"A step cannot be named {step_id}: it is a target."))
    if len(section.blocks) > 1:
        mistakes.append(Mistake(section.blocks[1][2] + 1, "A step has one action: begin a new step for this action."))
    if not section.blocks:
        return ProcedureStep(step_id, title, _prose(lines, section.line + 1, section.end), "text", section.line + 1)
    kind, content, start, end = section.blocks[0]
    prose = _prose(lines, section.line + 1, section.end, (start, end))
    bare = ProcedureStep(step_id, title, prose, next(a for a in ACTIONS if a == kind), section.line + 1, at=start + 2)
    try:
        return _with_action(bare, [line.strip() for line in content.splitlines() if line.strip()])
    except BadInput as error:
        mistakes.append(Mistake(start + 2, str(error)))
        return bare


def _with_action(bare: ProcedureStep, lines: Sequence[str]) -> ProcedureStep:
    """Return the step with its action. Raises BadInput if a line of the block cannot be read."""
    if not lines:
        raise BadInput(f"The {bare.kind} block is empty")
    action, seconds, branches = lines[0], 0.0, [*_branches(bare, lines)]
    if bare.kind == "check":
        within = [b.target for b in branches if b.when == "within"]
        seconds = seconds_of(within[0]) if within else 0.0
        branches = [b for b in branches if b.when != "within"]
    elif bare.kind == "wait":
        action, seconds = lines[0], seconds_of(lines[0])
    elif bare.kind == "branch":
        action = "; ".join(lines)
    elif bare.kind in ("hold", "sign"):
        action = " ".join(lines)
    return ProcedureStep(
        bare.id, bare.title, bare.text, bare.kind, bare.line, action, seconds, tuple(branches), bare.at
    )


def _branches(step: ProcedureStep, lines: Sequence[str]) -> list[Branch]:
    if step.kind in ("hold", "sign"):
        return []
    options = [OPTION.fullmatch(line) for line in (lines if step.kind == "branch" else lines[1:])]
    if any(option is None for option in options) or (options and step.kind in ("command", "wait")):
        expected = {"command": "one line", "wait": "one line", "branch": "if expression: step"}
        raise BadInput(
            f"The {step.kind} block has a line that cannot be read", expected=expected.get(step.kind, "name: value")
        )
    branches = [Branch(o["name"].strip(), o["value"].strip()) for o in options if o]
    if step.kind == "check" and not {b.when for b in branches} <= {"within", "else"}:
        raise BadInput("The check has an unknown option", expected="within: or else:", got=branches[0].when)
    if step.kind == "question" and not branches:
        raise BadInput("The question has no answers", expected="answer: step lines below it")
    if step.kind == "branch" and (branches[-1].when != "else" or any(b.when == "else" for b in branches[:-1])):
        raise BadInput("The branch does not end with an else line", expected="else: step as the last line")
    if step.kind == "branch" and not all(b.when.startswith("if ") for b in branches[:-1]):
        raise BadInput("The branch has a line that cannot be read", expected="if expression: step")
    if len({b.when for b in branches}) != len(branches):
        raise BadInput("The block has the same answer or option twice")
    return branches


def seconds_of(text: str) -> float:
    """Parse a duration such as ``90 s``, ``1.5 min`` or ``1 h`` and return it in seconds. Raises BadInput."""
    duration_match = DURATION.fullmatch(text.strip())
    seconds = float(duration_match["number"]) * SECONDS[duration_match["unit"]] if duration_match else 0.0
    if not 0 < seconds <= MAX_S:
        raise BadInput("The duration is not valid", expected="for example 90 s, 1.5 min or 1 h, at most 24 h", got=text)
    return seconds


def command_words(text: str) -> tuple[str, dict[str, str]]:
    """Split a command line into the command's name and its arguments as text. Raises BadInput."""
    try:
        name, *pairs = shlex.split(text)
    except ValueError as error:
        raise BadInput("The command line cannot be read", expected="NAME argument=value", got=str(error)) from None
    arguments = {}
    for pair in pairs:
        key, sign, value = pair.partition("=")
        if not sign or not key or key in arguments:
            raise BadInput("The command line cannot be read", expected="argument=value, each once", got=pair[:80])
        arguments[key] = value
    return name, arguments
