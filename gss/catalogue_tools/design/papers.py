"""Figures that the documents print for their cameras, shown next to the computed figures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperValue:
    """One printed figure. ``figure``: name of the computed figure to compare with. ``x``: position on the curve of that
    figure, NaN for a single number."""

    profile: str
    figure: str
    x: float
    value: float
    source: str


NAN = float("nan")
ERLANK_3_6 = ((3.0, 84.04, 52.61), (3.2, 90.51, 68.81), (3.4, 93.71, 82.52), (3.6, 99.15, 91.92), (3.8, 99.92, 98.92))
PAPER_VALUES: tuple[PaperValue, ...] = (
    PaperValue("sunsat", "limit_mag", NAN, 6.0, "Jacobs 1995 §6.3"),
    PaperValue("sunsat", "saturation_mag", NAN, 2.5, "Jacobs 1995 §6.3"),
    PaperValue("sunsat", "p_fewer_3_by_limit", 6.0, 0.0056, "Jacobs 1995 Table 5-1"),
    PaperValue("sunsat", "exclusion_deg", NAN, 28.1, "Jacobs 1995 eq. 7.26"),
    PaperValue("cubestar", "limit_mag", NAN, 3.8, "Erlank 2013 §4.3.2"),
    *(
        PaperValue("cubestar", "p_fewer_3_by_limit", v, round(1 - p / 100, 4), "Erlank 2013 Table 3.6")
        for v, p, _ in ERLANK_3_6
    ),
    *(
        PaperValue("cubestar", "p_fewer_5_by_limit", v, round(1 - p / 100, 4), "Erlank 2013 Table 3.6")
        for v, _, p in ERLANK_3_6
    ),
    PaperValue("far_mst", "limit_mag", NAN, 4.5, "Huffman 2006 Table 1.3"),
    PaperValue("oersted", "limit_mag", NAN, 4.5, "Liebe 1992"),
    PaperValue("aim", "limit_mag", NAN, 6.0, "Moniteq 1983 Table 7.3"),
    PaperValue("aim", "cross_median_arcsec", NAN, 0.5, "Moniteq 1983 Table 7.3, one V 6 star, 2 s"),
    PaperValue("far_mst", "cross_median_arcsec", NAN, 100.0, "Huffman 2006 Table 1.3, goal"),
    PaperValue("cubestar", "cross_median_arcsec", NAN, 14.4, "Erlank 2013 §4.4: largest error 0.004°"),
    PaperValue("aim", "exclusion_deg", NAN, 20.0, "Moniteq 1983 §5.2"),
)


def values_for(profile_name: str) -> tuple[PaperValue, ...]:
    """Return the figures of one camera."""
    return tuple(v for v in PAPER_VALUES if v.profile == profile_name)
