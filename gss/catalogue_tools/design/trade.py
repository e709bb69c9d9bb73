"""Camera comparison: the documents' cameras next to the edited camera, and one camera with a grid of lenses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.catalogue_tools.design.accuracy import accuracy
from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.in_view import affordable, bright_rows, pairs_in_view
from gss.catalogue_tools.design.radiometry import limit_mag, motion_blur, saturation_mag
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.experiment import Progress
from gss.domain.stars import StarTable

LENS_FOCALS = np.array([0.5, 0.7, 1.0, 1.4, 2.0])
"""Focal lengths of the trade-off, as multiples of the camera's focal length."""
LENS_F_NUMBERS = np.array([0.7, 1.0, 1.4])
"""f-numbers of the trade-off, as multiples of the camera's f-number; steps of the standard scale (Erlank 2013 Table
3.4)."""


@dataclass(frozen=True)
class TradeRow:
    """Figures of one camera.

    ``limit_mag``: active magnitude limit. ``stars``: mean number of stars in view. ``p_fewer_3``: fraction of fields
    with fewer than three stars. ``cross_rad``, ``roll_rad``: median accuracy over all fields, one axis, 1σ.
    ``blur_rate_rad_s``: angular rate that costs half a magnitude.
    """

    camera: DesignCamera
    limit_mag: float
    saturation_mag: float
    stars: float
    p_fewer_3: float
    pointings: int
    cross_rad: float
    roll_rad: float
    blur_rate_rad_s: float


def trade_row(camera: DesignCamera, stars: StarTable, attitudes: Array, max_pairs: float) -> TradeRow:
    """Assess one camera at (m, 3, 3) attitudes. Fewer attitudes are used if the camera detects very many stars."""
    limit = limit_mag(camera)
    rows = bright_rows(stars, limit)
    count = affordable(camera, rows, len(attitudes), max_pairs)
    pairs = pairs_in_view(stars.icrs[:rows], attitudes[:count], camera.shape)
    accuracies = accuracy(camera, stars, pairs)
    return TradeRow(
        camera,
        limit,
        saturation_mag(camera),
        float(pairs.count.mean()),
        float((pairs.count < 3).mean()),
        count,
        accuracies.cross_median_rad,
        accuracies.roll_median_rad,
        motion_blur(camera).rate_rad_s,
    )


def lens_trade(
    camera: DesignCamera, stars: StarTable, attitudes: Array, max_pairs: float, progress: Progress
) -> tuple[TradeRow, ...]:
    """Assess the camera with shorter, longer, faster and slower lenses, each with its radiometric magnitude limit.

    Star images keep their size in pixels. Lenses that give an invalid camera are omitted.
    """
    rows = []
    camera = replace(camera, mag_limit=None)
    for k, focal in enumerate(LENS_FOCALS):
        progress(k / len(LENS_FOCALS))
        for number in LENS_F_NUMBERS:
            try:
                other = replace(
                    camera, focal_mm=float(camera.focal_mm * focal), f_number=float(camera.f_number * number)
                )
            except BadInput:
                continue
            rows.append(trade_row(other, stars, attitudes, max_pairs))
    return tuple(rows)
