"""Wrong attitudes that the campaign found and that were corrected."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import cache

from gss.pipeline.chains.reference import NAME as REFERENCE
from validation.fingerprint import fingerprint
from validation.never_wrong.lists import OWN
from validation.never_wrong.record import SIZES, CampaignBlock

Input = tuple[str, str, str]
"""``lists`` or ``frames``, camera, and chain."""

FINGERPRINTS = (
    "9cdfbc9608b3",  # 8fcbf2b1
    "2de1cf3c9b36",  # c935182e
    "bb33b5314267",  # e2f2bca3
    "bbbc36a9fb8c",  # 5860e5e7
    "e051b55ed7de",  # e8ff7581
    "225562d54314",  # 89a33f5d
    "547ef3c47356",  # 1f3ea800
    "a39ca8cc1cc0",  # 6ca1b76a
    "d979b7132fb1",  # e46bd885
    "c6ce390f23fc",  # 5d5a25c0
    "137139a811c7",  # no commit; in results.json since 50eeb715
    "fefd4f3f4e7b",  # no commit; in results.json since a60e47a2
    "4cd3067f970b",  # no commit; in results.json since a60e47a2
    "13e625f8286e",  # 8e601041
    "9d0ba0271e0a",  # 97ef4c84
    "c3af0ac3ec56",  # 87ab5951
    "4a1d492729b7",  # ab57028b
    "61b37c4f3d76",  # 016245c3
    "cafa78cd79fc",  # 926e2533
    "a6c10486c5c8",  # 68095d9f
    "6bdd0546f603",  # fd367734
    "06756b54d929",  # e0e3fe5d
    "96ee80bd1a40",  # eeba1f99
    "aa170edeba03",  # 3b38955a
)
"""Sources of the stored results, oldest first, each with the first commit whose tree has this fingerprint. Every commit is an
ancestor of the next. Three have no commit, because the campaign ran before one; their place follows from the history of
``results.json`` and from the shard numbers, and what they contain from the messages of the commits that stored them. Append
the fingerprint of new results."""


@dataclass(frozen=True)
class FixedCase:
    """Wrong attitudes with one cause. ``found``: by input, the numbers of their attitudes or frames; None: not recorded.
    ``corrected_in``: the first of ``FINGERPRINTS`` that has the correction. ``text``: cases, cause and correction."""

    found: dict[Input, tuple[int | None, ...]]
    corrected_in: str
    text: str
    seed: int = 1

    def counted(self, blocks: list[CampaignBlock]) -> Counter[Input]:
        """Return the number of these wrong attitudes that limits from ``blocks`` must count, by input: those solved again with
        the correction, if other results of the same input and seed are from before it. Results before the correction
        contain the verdict of the case itself, as do results of one state of the sources, and a case outside the blocks is
        not one of their trials. A case counts if the order of the sources is unknown."""
        total: Counter[Input] = Counter()
        for key, numbers in self.found.items():
            same = [b for b in blocks if (b.name, b.camera, b.chain, b.seed) == (*key, self.seed)]
            if len({b.code for b in same}) > 1 and any(self._is_corrected(b.code) is not True for b in same):
                again = [b for b in same if self._is_corrected(b.code) is not False]
                total[key] = sum(any(n is None or b.contains(n // SIZES[b.name]) for b in again) for n in numbers)
        return total

    def _is_corrected(self, code: str) -> bool | None:
        """Return whether these sources have the correction; None: unknown."""
        if code == _present():
            return True
        if code not in FINGERPRINTS:
            return None
        return FINGERPRINTS.index(code) >= FINGERPRINTS.index(self.corrected_in)


def found_before(blocks: list[CampaignBlock]) -> Counter[Input]:
    """Return the number of corrected wrong attitudes that limits from ``blocks`` must count, by input."""
    total: Counter[Input] = Counter()
    for case in FIXED_CASES:
        total.update(case.counted(blocks))
    return total


@cache
def _present() -> str:
    """Return the fingerprint of the present sources, which have every correction."""
    return fingerprint()


def unknown_sources(blocks: list[CampaignBlock]) -> list[str]:
    """Return the fingerprints of ``blocks`` whose order is unknown, if it matters: if their seed has a case, and results of other
    sources for the same input exist. These results count as solved both before and after every correction."""
    seeds = {case.seed for case in FIXED_CASES}
    codes: dict[tuple[str, str, str, int], set[str]] = defaultdict(set)
    for block in blocks:
        if block.seed in seeds:
            codes[block.name, block.camera, block.chain, block.seed].add(block.code)
    mixed: set[str] = set().union(*(several for several in codes.values() if len(several) > 1))
    return sorted(mixed - {_present(), *FINGERPRINTS})


FIXED_CASES = (
    FixedCase(
        {("lists", "aim", OWN): (4085, 5417)},
        "9cdfbc9608b3",
        "aim, mirrored, tracking (attitudes 4085 and 5417): two stars matched their mirror image after a "
        "rotation. A match of two stars can now rotate a tracked attitude by at most the capture radius",
    ),
    FixedCase(
        {("lists", "sunsat", OWN): (1784,)},
        "9cdfbc9608b3",
        "sunsat, focal length −1 %, tracking (attitude 1784): three stars in a corner were matched correctly, but"
        " the boresight error was 6.4 px. This chain now also checks the focal length",
    ),
    FixedCase(
        {
            ("lists", "far_mst", REFERENCE): (3636, 4299, *[None] * 7),
            ("lists", "oersted", REFERENCE): (2389, 3777, *[None] * 7),
        },
        "9cdfbc9608b3",
        "reference with far_mst and oersted, mirrored or with false stars, planets or doubles (nine lists, among "
        "them attitudes 3636 and 4299 of far_mst, 2389 and 3777 of oersted): an attitude that matched a tenth to "
        "a fourth of the stars was accepted. Now three tenths of the stars must match",
    ),
    FixedCase(
        {("frames", "aim", REFERENCE): (4, 56)},
        "bb33b5314267",
        "reference with aim, frame trailed by 44 px (frames 4 and 56): four parts of trails matched, all "
        "displaced by 12 px or 5 px. A frame with trails longer than 26 px now has no attitude, also if the "
        "trails are faint, and the reason says so",
    ),
    FixedCase(
        {("frames", "oersted", OWN): (446, 500)},
        "bbbc36a9fb8c",
        "oersted, frame mirrored, tracking (frames 446 and 500): three and four of about thirty stars matched "
        "near the known attitude. The share of the matched stars is now tested",
    ),
    FixedCase(
        {("lists", "far_mst", OWN): (17723,), ("lists", "aim", OWN): (15013,)},
        "e051b55ed7de",
        "far_mst, mirrored, tracking (attitude 17723), and aim, mirrored, assisted (attitude 15013): five of 71 "
        "and four of 16 stars matched. These chains have the same test",
    ),
    FixedCase(
        {("lists", "far_mst", OWN): (38612, 76181)},
        "547ef3c47356",
        "far_mst, mirrored, tracking (attitudes 38612 and 76181): four of 25 stars matched, with a bound of 5e-7,"
        " because stars near the axis of the mirror image keep their places. Less than three tenths of the stars "
        "are now never enough",
    ),
    FixedCase(
        {("lists", "aim", OWN): (38936,)},
        "547ef3c47356",
        "aim, mirrored, tracking (attitude 38936): after a guidance error, three of three stars matched at an "
        "attitude that was rotated by 155° about the boresight. The rotation from a known attitude is now limited"
        " as well as the boresight",
    ),
    FixedCase(
        {("lists", "aim", OWN): (59329,)},
        "547ef3c47356",
        "aim, mirrored, assisted (attitude 59329): four of ten stars matched, with a bound of 1e-5. If the bound "
        "is above 1e-6, the mirrored frame must not match more stars",
    ),
    FixedCase(
        {("frames", "cubestar", OWN): (29,), ("lists", "oersted", REFERENCE): (11523,)},
        "9cdfbc9608b3",
        "cubestar, frame with 100 false stars, tracking (frame 29), and reference with oersted, bright stars "
        "saturated (attitude 11523): a star far from the others, a false match or displaced by 3 px, determined "
        "the roll angle. Now each star is compared with the position predicted by the others",
    ),
    FixedCase(
        {("lists", "cubestar", REFERENCE): (23194,)},
        "225562d54314",
        "reference with cubestar, mirrored with 10 false stars, assisted (attitude 23194): three of eight stars "
        "matched, with a bound of 9e-5. If less than four tenths of the stars match, all chains now require a "
        "bound of 1e-6",
    ),
    FixedCase(
        {("lists", "oersted", REFERENCE): (20805,)},
        "225562d54314",
        "reference with oersted, focal length +1 %, lost in space (attitude 20805): all 33 matches were correct, "
        "but the optical centre was fitted although the stars did not require it, and the boresight error was 12 "
        "px. Now the fitted centre must differ from the calibration by a χ² of 25",
    ),
    FixedCase(
        {("lists", "cubestar", REFERENCE): (63930,)},
        "fefd4f3f4e7b",
        "reference with cubestar, 5 false stars, lost in space (attitude 63930, not released): a false star 3 px "
        "from a star matched it and rotated the attitude about the other matches. A match of less than three "
        "quarters of the stars is now verified again without each detection from which it began",
    ),
    FixedCase(
        {("lists", "sunsat", REFERENCE): (51843,)},
        "d979b7132fb1",
        "reference with sunsat, mirrored with 10 false stars, lost in space (attitude 51843): the four matched "
        "stars lie in a line, so they match the mirrored frame as well. With the calibrated lens, up to six stars"
        " in a line no longer give an attitude",
    ),
    FixedCase(
        {("lists", "cubestar", OWN): (467671,)},
        "137139a811c7",
        "cubestar, a third of the stars missing and 2 false, assisted (attitude 467671): two stars and a false "
        "one matched with residuals four times their errors. Three or four stars must now have residuals that are"
        " more probable than an accidental match",
    ),
    FixedCase(
        {("lists", "aim", REFERENCE): (67110,)},
        "fefd4f3f4e7b",
        "reference with aim, mirrored, lost in space (attitude 67110): four of nine stars matched with a "
        "probability of 1e-7 of being accidental, although all nine match in the mirrored list. Above 1e-9, the "
        "mirrored list is now searched as well",
    ),
    FixedCase(
        {("lists", "aim", REFERENCE): (157831,)},
        "cafa78cd79fc",
        "reference with aim, a tenth of the stars variable, assisted (attitude 157831): three stars within 6 px, "
        "and the companion of a fourth instead of the fourth, rotated the attitude by 1.7°. A match of at least "
        "four stars near a known attitude is now also verified again without each detection from which it began",
    ),
    FixedCase(
        {("lists", "aim", OWN): (216752,)},
        "a6c10486c5c8",
        "aim, magnitudes +0.5, tracking (attitude 216752): two stars 1.3 px apart matched correctly, but do not "
        "determine the rotation about them, and the boresight was 7.8 px off. AIM's and Oersted's chains now "
        "require that three standard deviations of the boresight are at most 5 px, as Sunsat's chain does",
    ),
    FixedCase(
        {("lists", "aim", OWN): (534877,)},
        "96ee80bd1a40",
        "aim, mirrored, assisted (attitude 534877): all three stars matched by accident, with a bound of 4e-4, "
        "and three match in the mirrored frame as well. Three or more stars must now be more than those that "
        "match in the mirrored frame",
    ),
)
"""For the nine lists of far_mst and oersted, the number of each camera was not recorded; nine are stated for both. The case
63930 was never in a commit, but the search before it had no second verification either, so that earlier results count."""
