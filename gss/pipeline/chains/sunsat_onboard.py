"""Sunsat's chain on the device. Commanded values replace its parameters; durations are from the document."""

from __future__ import annotations

from dataclasses import replace

from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Centroids
from gss.pipeline.chains import sunsat
from gss.pipeline.chains.modes import Mode, next_mode
from gss.pipeline.chains.onboard import Commanded, Detection, OnboardSolution, Work, with_detection
from gss.pipeline.chains.sunsat_match import (
    SunsatCatalogue,
    SunsatMatching,
    check_hint,
    prepare,
)
from gss.pipeline.chains.sunsat_parameters import NAME, OLDEST_ATTITUDE_S, SunsatParameters, default_parameters
from gss.pipeline.chains.sunsat_track import find_in_windows, match_tracking
from gss.pipeline.regions import Pixels
from gss.skytables.bank import OnboardCatalogue

# Jacobs 1995 Fig. 2-7: 90 ms for a region of 900 pixels, 100 ms for three of 300; a frame without stars takes 48 629 pixel tests.
LOOK_MS, STAR_MS, STAR_PIXEL_MS = 0.005, 3.0, 0.1
# Jacobs 1995 Table 3-7: 14 s on average for the fourth row, whose rerun needs 377 table entries and splitting steps.
# §4.3: less than 0.1 s for a tracking iteration without star detection.
ENTRY_MS, TRACKING_MS, ATTITUDE_MS = 37.0, 90.0, 10.0


class SunsatChain:
    """See :class:`gss.pipeline.chains.onboard.OnboardChain`."""

    name = NAME
    oldest_attitude_s = OLDEST_ATTITUDE_S

    def parameters(
        self, profile: CameraProfile, exposure_s: float | None, commanded: Commanded, mode: Mode
    ) -> SunsatParameters:
        base = with_detection(default_parameters(profile, exposure_s), commanded)
        if mode is Mode.ASSISTED and commanded.hint_radius_rad is not None:
            return replace(base, hint_error_rad=commanded.hint_radius_rad)
        return base

    def prepare(self, catalogue: OnboardCatalogue, profile: CameraProfile) -> SunsatCatalogue:
        return prepare(catalogue)

    def find_centroids(self, pixels: Pixels, work: Work) -> Detection:
        if work.mode is Mode.TRACKING:
            hint = check_hint(work.mode, work.hint)
            return find_in_windows(pixels, work.camera, work.catalogue, work.parameters, hint, work.dark)
        return sunsat.find_in_frame(pixels, work.parameters, work.dark)

    def match_stars(self, centroids: Centroids, work: Work) -> SunsatMatching:
        if work.mode is Mode.TRACKING:
            hint = check_hint(work.mode, work.hint)
            return match_tracking(centroids, work.camera, work.catalogue, work.parameters, hint)
        return sunsat.match_stars(centroids, work.camera, work.catalogue, work.parameters, work.mode, work.hint)

    def calculate_attitude(self, matching: SunsatMatching, centroids: Centroids, work: Work) -> OnboardSolution:
        return sunsat.calculate_attitude(matching, centroids, work.camera, work.catalogue, work.parameters, work.hint)

    def next_mode(self, mode: Mode, solved: bool) -> Mode:
        return next_mode(mode, solved)

    def detect_ms(self, pixels: int, detection: Detection) -> float:
        lit = sum(r.area_px for r in detection.regions)
        return LOOK_MS * pixels / 9 + STAR_MS * len(detection.regions) + STAR_PIXEL_MS * lit

    def match_ms(self, matching: SunsatMatching) -> float:
        return TRACKING_MS if matching.mode is Mode.TRACKING else ENTRY_MS * matching.operations

    def attitude_ms(self, matching: SunsatMatching) -> float:
        return ATTITUDE_MS
