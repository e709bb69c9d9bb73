"""Wrong attitudes that the campaign found and that were corrected."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from gss.pipeline.chains.reference import NAME as REFERENCE
from validation.never_wrong.lists import OWN

Input = tuple[str, str, str]
"""``lists`` or ``frames``, camera, and chain."""


@dataclass(frozen=True)
class FixedCase:
    """Wrong attitudes with one cause. ``found``: number by input. ``text``: cases, cause and correction."""

    found: dict[Input, int]
    text: str


def found_before() -> Counter[Input]:
    """Return the number of wrong attitudes that were found and corrected. Most lists were solved before a correction, so
    limits of the share of wrong solutions must count them."""
    total: Counter[Input] = Counter()
    for case in FIXED_CASES:
        total.update(case.found)
    return total


FIXED_CASES = (
    FixedCase(
        {("lists", "aim", OWN): 2},
        "aim, mirrored, tracking (attitudes 4085 and 5417): two stars matched their mirror image after a "
        "rotation. A match of two stars can now rotate a tracked attitude by at most the capture radius",
    ),
    FixedCase(
        {("lists", "sunsat", OWN): 1},
        "sunsat, focal length −1 %, tracking (attitude 1784): three stars in a corner were matched correctly, but"
        " the boresight error was 6.4 px. This chain now also checks the focal length",
    ),
    FixedCase(
        {("lists", "far_mst", REFERENCE): 9, ("lists", "oersted", REFERENCE): 9},
        "reference with far_mst and oersted, mirrored or with false stars, planets or doubles (nine lists, among "
        "them attitudes 3636 and 4299 of far_mst, 2389 and 3777 of oersted): an attitude that matched a tenth to "
        "a fourth of the stars was accepted. Now three tenths of the stars must match",
    ),
    FixedCase(
        {("frames", "aim", REFERENCE): 2},
        "reference with aim, frame trailed by 44 px (frames 4 and 56): four parts of trails matched, all "
        "displaced by 12 px or 5 px. A frame with trails longer than 26 px now has no attitude, also if the "
        "trails are faint, and the reason says so",
    ),
    FixedCase(
        {("frames", "oersted", OWN): 2},
        "oersted, frame mirrored, tracking (frames 446 and 500): three and four of about thirty stars matched "
        "near the known attitude. The share of the matched stars is now tested",
    ),
    FixedCase(
        {("lists", "far_mst", OWN): 1, ("lists", "aim", OWN): 1},
        "far_mst, mirrored, tracking (attitude 17723), and aim, mirrored, assisted (attitude 15013): five of 71 "
        "and four of 16 stars matched. These chains have the same test",
    ),
    FixedCase(
        {("lists", "far_mst", OWN): 2},
        "far_mst, mirrored, tracking (attitudes 38612 and 76181): four of 25 stars matched, with a bound of 5e-7,"
        " because stars near the axis of the mirror image keep their places. Less than three tenths of the stars "
        "are now never enough",
    ),
    FixedCase(
        {("lists", "aim", OWN): 1},
        "aim, mirrored, tracking (attitude 38936): after a guidance error, three of three stars matched at an "
        "attitude that was rotated by 155° about the boresight. The rotation from a known attitude is now limited"
        " as well as the boresight",
    ),
    FixedCase(
        {("lists", "aim", OWN): 1},
        "aim, mirrored, assisted (attitude 59329): four of ten stars matched, with a bound of 1e-5. If the bound "
        "is above 1e-6, the mirrored frame must not match more stars",
    ),
    FixedCase(
        {("frames", "cubestar", OWN): 1, ("lists", "oersted", REFERENCE): 1},
        "cubestar, frame with 100 false stars, tracking (frame 29), and reference with oersted, bright stars "
        "saturated (attitude 11523): a star far from the others, a false match or displaced by 3 px, determined "
        "the roll angle. Now each star is compared with the position predicted by the others",
    ),
    FixedCase(
        {("lists", "cubestar", REFERENCE): 1},
        "reference with cubestar, mirrored with 10 false stars, assisted (attitude 23194): three of eight stars "
        "matched, with a bound of 9e-5. If less than four tenths of the stars match, all chains now require a "
        "bound of 1e-6",
    ),
    FixedCase(
        {("lists", "oersted", REFERENCE): 1},
        "reference with oersted, focal length +1 %, lost in space (attitude 20805): all 33 matches were correct, "
        "but the optical centre was fitted although the stars did not require it, and the boresight error was 12 "
        "px. Now the fitted centre must differ from the calibration by a χ² of 25",
    ),
    FixedCase(
        {("lists", "cubestar", REFERENCE): 1},
        "reference with cubestar, 5 false stars, lost in space (attitude 63930, not released): a false star 3 px "
        "from a star matched it and rotated the attitude about the other matches. A match of less than three "
        "quarters of the stars is now verified again without each detection from which it began",
    ),
    FixedCase(
        {("lists", "sunsat", REFERENCE): 1},
        "reference with sunsat, mirrored with 10 false stars, lost in space (attitude 51843): the four matched "
        "stars lie in a line, so they match the mirrored frame as well. With the calibrated lens, up to six stars"
        " in a line no longer give an attitude",
    ),
    FixedCase(
        {("lists", "cubestar", OWN): 1},
        "cubestar, a third of the stars missing and 2 false, assisted (attitude 467671): two stars and a false "
        "one matched with residuals four times their errors. Three or four stars must now have residuals that are"
        " more probable than an accidental match",
    ),
    FixedCase(
        {("lists", "aim", REFERENCE): 1},
        "reference with aim, mirrored, lost in space (attitude 67110): four of nine stars matched with a "
        "probability of 1e-7 of being accidental, although all nine match in the mirrored list. Above 1e-9, the "
        "mirrored list is now searched as well",
    ),
    FixedCase(
        {("lists", "aim", REFERENCE): 1},
        "reference with aim, a tenth of the stars variable, assisted (attitude 157831): three stars within 6 px, "
        "and the companion of a fourth instead of the fourth, rotated the attitude by 1.7°. A match of at least "
        "four stars near a known attitude is now also verified again without each detection from which it began",
    ),
    FixedCase(
        {("lists", "aim", OWN): 1},
        "aim, magnitudes +0.5, tracking (attitude 216752): two stars 1.3 px apart matched correctly, but do not "
        "determine the rotation about them, and the boresight was 7.8 px off. AIM's and Oersted's chains now "
        "require that three standard deviations of the boresight are at most 5 px, as Sunsat's chain does",
    ),
    FixedCase(
        {("lists", "aim", OWN): 1},
        "aim, mirrored, assisted (attitude 534877): all three stars matched by accident, with a bound of 4e-4, "
        "and three match in the mirrored frame as well. Three or more stars must now be more than those that "
        "match in the mirrored frame",
    ),
)
"""For the nine lists of far_mst and oersted, the number of each camera was not recorded; nine count for both."""
