"""Writes ``docs/never-wrong.md`` from a campaign's results: correct, imprecise, wrong and none by camera, chain, fault and
mode."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any

from gss.domain.experiment import share_interval
from gss.domain.results import Verdict
from gss.operations.studies.never_wrong import Hunt, keys, selected
from gss.pipeline.experiments.never_wrong import MODES
from gss.pipeline.experiments.never_wrong_campaign import CAMERAS, OWN, setting_of
from gss.pipeline.experiments.never_wrong_faults import FAULTS
from gss.pipeline.experiments.never_wrong_frames import FRAME_FAULTS
from gss.pipeline.experiments.never_wrong_sky import ANOTHER

MENDED = "\n".join(
    (
        "- aim, mirrored, tracking (attitudes 4085 and 5417): two stars fit their mirror image after a turn; two may now turn a "
        "tracked attitude by no more than the radius of capture",
        "- sunsat, focal length −1 %, tracking (attitude 1784): three stars in a corner, right names, boresight 6.4 px off; the "
        "census of focal lengths now stands in this chain too",
        "- reference with far_mst and oersted, mirrored or with false stars, planets or doubles (nine lists, among them attitudes "
        "3636 and 4299 of far_mst, 2389 and 3777 of oersted): a place that named a tenth to a fourth of the stars passed the odds; "
        "three tenths must be named now",
    )
)
ORDER = (Verdict.CORRECT, Verdict.IMPRECISE, Verdict.WRONG, Verdict.NONE)
Cells = dict[tuple[str, str, str], dict[tuple[int, int], Counter[str]]]
"""By kind, camera and chain, then by fault and mode."""


def page(wanted: Hunt, done: dict[Any, dict[str, Any]]) -> str:
    """Return the page as Markdown. Only shards of this hunt count; missing shards are reported."""
    used = selected(done, wanted)
    cells: Cells = defaultdict(lambda: defaultdict(Counter))
    for key in used:
        for fault, mode, verdict, number in done[key]["counts"]:
            cells[done[key]["kind"], key.camera, key.chain][fault, mode][verdict] += number
    wrong = sorted(text for key in used for text in done[key]["wrong"])
    parts = [_head(wanted, wrong, _made_by(used, done), len(keys(wanted)) - len(used)), _summary(cells)]
    for kind, faults, title in (("lists", FAULTS, "Lists of centroids"), ("frames", FRAME_FAULTS, "From pixels")):
        here = [c for c in CAMERAS if any((kind, c, chain) in cells for chain in wanted.chains)]
        tables = [_table(kind, camera, wanted, cells, [f.title for f in faults]) for camera in here]
        parts += [f"## {title}\n\n{_MODES_SAID}\n", *tables]
    return "\n".join(parts).rstrip() + "\n"


_MODES_SAID = (
    "Each cell: correct/imprecise/wrong/none. The modes follow one another from attitude to attitude; "
    "both chains of a camera get the same input."
)


def _made_by(used: set[Any], done: dict[Any, dict[str, Any]]) -> str:
    """List the source fingerprints and the number of shards of each."""
    codes = Counter(done[key]["code"] for key in used)
    return ", ".join(f"{code} ({number} shards)" for code, number in sorted(codes.items())) or "none"


def _head(wanted: Hunt, wrong: list[str], made_by: str, missing: int) -> str:
    conditions = "\n".join(
        f"- {s.camera}: bank to V {s.bank_mag}, sees to V {s.seen_mag}, errors {s.noise_px} px and {s.noise_mag} mag; frames of "
        f"“another camera” are {ANOTHER[s.camera]}'s"
        for s in (setting_of(c, OWN) for c in CAMERAS)
    )
    found = (
        "\n".join(f"- {text}" for text in wrong)
        if wrong
        else "None: no false attitude left any chain in this campaign."
    )
    left = f" {missing} shards are still to be run: their attitudes are in no count." if missing else ""
    asked = "" if wanted == Hunt() else f" --attitudes {wanted.attitudes} --frames {wanted.frames} --seed {wanted.seed}"
    return f"""# Never wrong

Written by `gss experiments never-wrong{asked} --page FILE`; sources {made_by}.{left} Every camera's own chain and
the reference chain were asked for {wanted.attitudes} random attitudes as lists and {wanted.frames} as frames, each with one fault
and one mode; a seed ({wanted.seed}), the camera and the number of the attitude make any of them again. No answer is an answer; a
false one is not:

- **correct**: across the boresight within three of its own standard deviations, all names right
- **imprecise**: right, but further off than that
- **wrong**: a false name in the attitude, or more than five pixels off; for a mirrored list or frame, and for one without
  stars, any answer
- **none**: said that there is no solution, and why

{conditions}

## Wrong answers

{found}

Found by earlier runs of the same seed, mended, and kept as tests:

{MENDED}
"""


def _summary(cells: Cells) -> str:
    rows = []
    for (kind, camera, chain), by_fault in sorted(cells.items(), key=lambda item: (item[0][0] != "lists", item[0])):
        counts = sum(by_fault.values(), Counter[str]())
        total, none = counts.total(), counts[Verdict.NONE]
        bad = counts[Verdict.WRONG]
        most = 100 * share_interval(bad, total - none)[1]
        rows.append(
            f"| {camera} | {chain if chain != OWN else setting_of(camera, OWN).chain + ' (own)'} | {kind} | {total} | "
            + " | ".join(str(counts[v]) for v in ORDER)
            + f" | < {most:.2g} % |"
        )
    head = "| camera | chain | input | asked | correct | imprecise | wrong | none | wrong of its answers, 95 % |"
    return "## All faults together\n\n" + head + "\n|" + "---|" * 9 + "\n" + "\n".join(rows) + "\n"


def _table(kind: str, camera: str, wanted: Hunt, cells: Cells, titles: list[str]) -> str:
    chains = [c for c in wanted.chains if (kind, camera, c) in cells]
    names = {c: setting_of(camera, OWN).chain if c == OWN else c for c in chains}
    head = [f"{names[c]}, {m.value.replace('_', ' ')}" for c in chains for m in MODES]
    lines = [f"### {camera}, {kind}\n", "| fault | " + " | ".join(head) + " | wrong |", "|" + "---|" * (len(head) + 2)]
    for j, title in enumerate(titles):
        found = [cells[kind, camera, c][j, k] for c in chains for k in range(len(MODES))]
        wrong = sum(f[Verdict.WRONG] for f in found)
        lines.append(f"| {title} | " + " | ".join("/".join(str(f[v]) for v in ORDER) for f in found) + f" | {wrong} |")
    return "\n".join(lines) + "\n"
