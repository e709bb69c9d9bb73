"""Cache of sky data for solving: star positions, pair tables, star figures (patterns of neighbouring stars for the blind
solver), and catalogues like those in a flash bank."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.stars import StarTable
from gss.operations.frames.figure_files import FigureFiles
from gss.pipeline.chains import reference
from gss.pipeline.chains.onboard import OnboardChain
from gss.pipeline.identify.patterns import PatternLevel, build_level
from gss.pipeline.identify.verify import SkyCatalogue
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table

T = TypeVar("T")
FIGURES_JYEAR, FIGURES_STEP_YR = 2026.0, 10.0
"""First epoch of the blind solver's dictionaries, and step between epochs. In half a step, nine of ten stars to V 7
move by less than 0.6″. The fastest star moves by 27″."""


class SolverCache:
    """Cache of star positions per epoch, pair tables per camera, figures per size, and bank catalogues per profile.

    Each object is built once. The latest ``keep`` objects are cached. Thread-safe.
    """

    def __init__(self, stars: StarTable | None = None, keep: int = 40, folder: Path | None = None) -> None:
        """Create an empty cache. ``folder``: on-disk cache of the blind solver's dictionaries; None: memory only."""
        self._base, self._keep = stars, keep
        self._files = None if folder is None else FigureFiles(folder)
        self._lock = threading.RLock()
        self._cached: dict[tuple[Any, ...], Any] = {}

    def _once(self, key: tuple[Any, ...], build: Callable[[], T]) -> T:
        with self._lock:
            if key not in self._cached:
                while len(self._cached) >= self._keep:
                    self._cached.pop(next(iter(self._cached)))
                self._cached[key] = build()
            return cast(T, self._cached[key])

    def stars(self, epoch_jyear: float) -> StarTable:
        """Return the star table at an epoch, brightest first."""

        def build() -> StarTable:
            table = propagate(self._base if self._base is not None else load_stars(), epoch_jyear)
            return table.take(np.argsort(table.v_mag, kind="stable"))

        return self._once(("stars", epoch_jyear), build)

    def sky(self, epoch_jyear: float) -> SkyCatalogue:
        """Return the star columns that identification uses, at an epoch."""
        table = self.stars(epoch_jyear)
        return SkyCatalogue(table.hip, table.icrs, table.v_mag)

    def known(self, camera: Camera, faint_limit_mag: float, epoch_jyear: float) -> reference.KnownSky:
        """Return the stars and the pair table for one camera, to a magnitude limit."""
        key = ("pairs", camera, faint_limit_mag, epoch_jyear)
        return self._once(key, lambda: reference.known_sky(self.sky(epoch_jyear), camera, faint_limit_mag))

    def level(self, epoch_jyear: float) -> Callable[[float], PatternLevel]:
        """Return a function from a radius in rad to the dictionary of star figures of that size, which is cached."""
        # Star figures tolerate the proper motion of several years, so all frames of a decade share one dictionary. The
        # attitude is computed with the star positions at the frame's epoch.
        year = FIGURES_JYEAR + FIGURES_STEP_YR * round((epoch_jyear - FIGURES_JYEAR) / FIGURES_STEP_YR)
        sky = self.sky(year)
        if self._files is None:
            return lambda radius_rad: self._once(("figures", radius_rad, year), lambda: build_level(sky, radius_rad))
        files = self._once(("figure files", year), partial(self._files.levels, sky))
        return lambda radius_rad: self._once(("figures", radius_rad, year), lambda: files(radius_rad))

    def bank(self, profile: CameraProfile, epoch_jyear: float) -> OnboardCatalogue:
        """Return a catalogue like the one in a flash bank of this camera: the stars to the magnitude limit of the
        camera, and their distances without quantisation."""

        def build() -> OnboardCatalogue:
            stars = self.stars(epoch_jyear).brighter_than(profile.sensor.faint_limit_mag)
            distances = distance_table(stars, 0.0, profile.camera.diagonal_rad)
            return OnboardCatalogue(stars.hip, stars.icrs, stars.v_mag, distances)

        return self._once(("bank", profile.camera, profile.sensor.faint_limit_mag, epoch_jyear), build)

    def prepared(self, chain: OnboardChain, profile: CameraProfile, epoch_jyear: float) -> Any:
        """Return the catalogue of :meth:`bank`, prepared by the chain of a system."""
        key = ("prepared", chain.name, profile.camera, profile.sensor, epoch_jyear)
        return self._once(key, lambda: chain.prepare(self.bank(profile, epoch_jyear), profile))
