"""Mortari's pyramid match as described in Huffman 2006 §5.5.4: a unique triangle, confirmed by a fourth star."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from gss.domain.angles import Array
from gss.pipeline.identify.baselines import Baselines
from gss.pipeline.identify.n_vertex import figures, match_figure
from gss.skytables.kvector import Rows


@dataclass(frozen=True)
class Pyramid:
    """Triangle confirmed by a fourth star. ``figure``: four imaged stars; ``names``: (4,) catalogue rows of these stars."""

    figure: tuple[int, ...]
    names: Rows


def pyramids(unit_cam: Array, icrs: Array, baselines: Baselines, most_figures: int) -> Iterator[Pyramid]:
    """Yield the unique triangles confirmed by a fourth star, testing at most ``most_figures`` triangles."""
    n = len(unit_cam)
    for count, triad in enumerate(figures(n, 3)):
        if count >= most_figures:
            return
        if len(match_figure(triad, baselines, unit_cam, icrs)) != 1:
            continue
        for fourth in range(n):
            if fourth in triad:
                continue
            names = match_figure((*triad, fourth), baselines, unit_cam, icrs)
            if len(names) == 1:
                yield Pyramid((*triad, fourth), names[0])
                break
