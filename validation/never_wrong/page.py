"""Write ``docs/never-wrong.md`` from the results of a campaign: counts of correct, imprecise, wrong and none by camera,
chain, fault and mode."""

from __future__ import annotations

from collections import Counter, defaultdict

from gss.domain.experiment import share_interval
from gss.domain.results import Verdict
from validation.never_wrong.faults import FAULTS
from validation.never_wrong.frames import FRAME_FAULTS
from validation.never_wrong.lists import CAMERAS, CHAINS, OWN, setting_of
from validation.never_wrong.record import CampaignBlock
from validation.never_wrong.sky import OTHER_CAMERA
from validation.never_wrong.table import MODES

FIXED_CASES = "\n".join(
    (
        "- aim, mirrored, tracking (attitudes 4085 and 5417): two stars matched their mirror image after a "
        "rotation. A match of two stars can now rotate a tracked attitude by at most the capture radius",
        "- sunsat, focal length −1 %, tracking (attitude 1784): three stars in a corner were matched correctly, "
        "but the boresight error was 6.4 px. This chain now also checks the focal length",
        "- reference with far_mst and oersted, mirrored or with false stars, planets or doubles (nine lists, among them attitudes "
        "3636 and 4299 of far_mst, 2389 and 3777 of oersted): an attitude that matched a tenth to a fourth of "
        "the stars was accepted. Now three tenths of the stars must match",
        "- reference with aim, frame trailed by 44 px (frames 4 and 56): four parts of trails matched, all displaced by 12 px or "
        "5 px. A frame with trails longer than 26 px now has no attitude, also if the trails are faint, and the reason says so",
        "- oersted, frame mirrored, tracking (frames 446 and 500): three and four of about thirty stars matched near the known "
        "attitude. The share of the matched stars is now tested",
        "- far_mst, mirrored, tracking (attitude 17723), and aim, mirrored, assisted (attitude 15013): five of 71 and four of 16 "
        "stars matched. These chains have the same test",
        "- far_mst, mirrored, tracking (attitudes 38612 and 76181): four of 25 stars matched, with a bound of 5e-7, because "
        "stars near the axis of the mirror image keep their places. Less than three tenths of the stars are now never enough",
        "- aim, mirrored, tracking (attitude 38936): after a guidance error, three of three stars matched at an attitude that was "
        "rotated by 155° about the boresight. The rotation from a known attitude is now limited as well as the boresight",
        "- aim, mirrored, assisted (attitude 59329): four of ten stars matched, with a bound of 1e-5. If the bound is above 1e-6, "
        "the mirrored frame must not match more stars",
        "- cubestar, frame with 100 false stars, tracking (frame 29), and reference with oersted, bright stars saturated (attitude "
        "11523): a star far from the others, a false match or displaced by 3 px, determined the roll angle. Now each star is "
        "compared with the position predicted by the others",
        "- reference with cubestar, mirrored with 10 false stars, assisted (attitude 23194): three of eight stars matched, with a "
        "bound of 9e-5. If less than four tenths of the stars match, all chains now require a bound of 1e-6",
        "- reference with oersted, focal length +1 %, lost in space (attitude 20805): all 33 matches were correct, but the optical "
        "centre was fitted although the stars did not require it, and the boresight error was 12 px. Now the fitted centre must "
        "differ from the calibration by a χ² of 25",
        "- reference with cubestar, 5 false stars, lost in space (attitude 63930, not released): a false star 3 px from a star "
        "matched it and rotated the attitude about the other matches. A match of less than three quarters of the stars is now "
        "verified again without each detection from which it began",
        "- reference with sunsat, mirrored with 10 false stars, lost in space (attitude 51843): the four matched stars lie in a "
        "line, so they match the mirrored frame as well. With the calibrated lens, up to six stars in a line no longer give an "
        "attitude",
        "- cubestar, a third of the stars missing and 2 false, assisted (attitude 467671): two stars and a false one matched with "
        "residuals four times their errors. Three or four stars must now have residuals that are more probable than an "
        "accidental match",
        "- reference with aim, mirrored, lost in space (attitude 67110): four of nine stars matched with a probability of 1e-7 of "
        "being accidental, although all nine match in the mirrored list. Above 1e-9, the mirrored list is now searched as well",
        "- reference with aim, a tenth of the stars variable, assisted (attitude 157831): three stars within 6 px, and the "
        "companion of a fourth instead of the fourth, rotated the attitude by 1.7°. A match of at least four stars near a known "
        "attitude is now also verified again without each detection from which it began",
        "- aim, magnitudes +0.5, tracking (attitude 216752): two stars 1.3 px apart matched correctly, but do not determine the "
        "rotation about them, and the boresight was 7.8 px off. AIM's and Oersted's chains now require that three standard "
        "deviations of the boresight are at most 5 px, as Sunsat's chain does",
        "- aim, mirrored, assisted (attitude 534877): all three stars matched by accident, with a bound of 4e-4, and three match "
        "in the mirrored frame as well. Three or more stars must now be more than those that match in the mirrored frame",
    )
)
ORDER = (Verdict.CORRECT, Verdict.IMPRECISE, Verdict.WRONG, Verdict.NONE)
Cells = dict[tuple[str, str, str], dict[tuple[int, int], Counter[str]]]
"""Counts by kind, camera and chain, then by fault and mode."""


def page(blocks: list[CampaignBlock], seed: int, file: str) -> str:
    """Return the page as Markdown. ``blocks``: those of this seed. ``file``: name of the file that contains them."""
    cells: Cells = defaultdict(lambda: defaultdict(Counter))
    for block in blocks:
        for (fault, mode, verdict), number in block.counts.items():
            cells[block.name, block.camera, block.chain][fault, mode][verdict] += number
    parts = [_head(blocks, seed, file), _summary(cells)]
    for kind, faults, title in (("lists", FAULTS, "Centroid lists"), ("frames", FRAME_FAULTS, "Rendered frames")):
        cameras = [c for c in CAMERAS if any((kind, c, chain) in cells for chain in CHAINS)]
        tables = [_table(kind, camera, cells, [f.title for f in faults]) for camera in cameras]
        parts += [f"## {title}\n\n{MODES_TEXT}\n", *tables]
    return "\n".join(parts).rstrip() + "\n"


MODES_TEXT = (
    "Each cell: correct/imprecise/wrong/none. Successive attitudes use the modes in turn. "
    "Both chains of a camera get the same input."
)


def _made_by(blocks: list[CampaignBlock]) -> str:
    """Return the fingerprints of the sources with the number of lists and frames of each."""
    cases: dict[str, Counter[str]] = defaultdict(Counter)
    for block in blocks:
        cases[block.code][block.name] += block.cases
    return "; ".join(f"{code}: {n['lists']} lists and {n['frames']} frames" for code, n in sorted(cases.items()))


def _head(blocks: list[CampaignBlock], seed: int, file: str) -> str:
    wrong = sorted(text for block in blocks for text in block.wrong)
    conditions = "\n".join(
        f"- {s.camera}: bank to V {s.bank_mag}; measures stars to V {s.seen_mag}, with errors of {s.noise_px} px and "
        f"{s.noise_mag} mag (1σ); “another camera” is {OTHER_CAMERA[s.camera]}"
        for s in (setting_of(c, OWN) for c in CAMERAS)
    )
    summary = (
        "\n".join(f"- {text}" for text in wrong)
        if wrong
        else "None: no chain returned a false attitude in this campaign."
    )
    return f"""# Never-wrong campaign

For engineers and reviewers. Generated by `gss experiments never-wrong --seed {seed} --keep {file} --page FILE`.
Fingerprints of the sources: {_made_by(blocks)}.

The campaign searches for false attitudes. For each camera, its own chain and the reference chain solve
centroid lists and rendered frames at random attitudes. Each list or frame has one fault and is solved in one mode.
You can reproduce a case from the seed ({seed}), the camera and the number of the attitude. Verdicts:

- **correct**: cross-boresight error within three of its standard deviations, all matches correct
- **imprecise**: correct matches, but a larger error
- **wrong**: a false match in the attitude, or an error of more than five pixels; for a mirrored list or
  frame, and for a frame without stars, any solution
- **none**: no solution, with a reason

A match is correct if its star or the light of its star is at most three pixels from the centroid. Some faults displace the
light: saturated stars by a pixel (one standard deviation in each direction), stars with a companion by up to 1.5 px. The
attitude is compared with the camera's.

Settings of each camera:

{conditions}

## Wrong results

{summary}

Earlier runs with the same seed detected these cases. They are fixed and covered by tests:

{FIXED_CASES}
"""


def _summary(cells: Cells) -> str:
    rows = []
    for (kind, camera, chain), by_fault in sorted(cells.items(), key=lambda item: (item[0][0] != "lists", item[0])):
        counts = sum(by_fault.values(), Counter[str]())
        total, none = counts.total(), counts[Verdict.NONE]
        bad = counts[Verdict.WRONG]
        upper_limit = 100 * share_interval(bad, total - none)[1]
        rows.append(
            f"| {camera} | {chain if chain != OWN else setting_of(camera, OWN).chain + ' (own)'} | {kind} | {total} | "
            + " | ".join(str(counts[v]) for v in ORDER)
            + f" | < {upper_limit:.2g} % |"
        )
    head = "| camera | chain | input | cases | correct | imprecise | wrong | none | wrong solutions, upper 95 % limit |"
    return "## All faults\n\n" + head + "\n|" + "---|" * 9 + "\n" + "\n".join(rows) + "\n"


def _table(kind: str, camera: str, cells: Cells, titles: list[str]) -> str:
    chains = [c for c in CHAINS if (kind, camera, c) in cells]
    names = {c: setting_of(camera, OWN).chain if c == OWN else c for c in chains}
    head = [f"{names[c]}, {m.value.replace('_', ' ')}" for c in chains for m in MODES]
    lines = [f"### {camera}, {kind}\n", "| fault | " + " | ".join(head) + " | wrong |", "|" + "---|" * (len(head) + 2)]
    for j, title in enumerate(titles):
        counts = [cells[kind, camera, c][j, k] for c in chains for k in range(len(MODES))]
        wrong = sum(f[Verdict.WRONG] for f in counts)
        lines.append(f"| {title} | " + " | ".join("/".join(str(f[v]) for v in ORDER) for f in counts) + f" | {wrong} |")
    return "\n".join(lines) + "\n"
