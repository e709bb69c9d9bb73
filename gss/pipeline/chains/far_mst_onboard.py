"""FAR-MST's chain on the device. Commanded values replace its parameters; durations are from the document."""

from __future__ import annotations

from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Centroids
from gss.pipeline.chains import far_mst
from gss.pipeline.chains.far_mst_catalogue import FarMstCatalogue, far_mst_catalogue
from gss.pipeline.chains.far_mst_detect import find_centroids
from gss.pipeline.chains.far_mst_match import FarMstMatching, match_stars
from gss.pipeline.chains.far_mst_parameters import NAME, FarMstParameters, default_parameters
from gss.pipeline.chains.modes import Mode, next_mode
from gss.pipeline.chains.onboard import Commanded, Detection, OnboardSolution, Work, with_commanded
from gss.pipeline.regions import Pixels
from gss.skytables.bank import OnboardCatalogue

# Huffman 2006 Table 7.2 at 2 σ: 0.170 s for the sliding pre-filter of 1280 x 1024 pixels, 1.4 ms per star; §7.4: 8.3 s
# for 14 frames, 0.22 s of each for matching and QUEST. These times are for Matlab in 2006; the document has no times
# for the planned flight code in C.
PIXEL_MS, STAR_MS = 169.8 / (1280 * 1024), 1.4
MATCH_MS, ENTRY_MS = 180.0, 0.01
ATTITUDE_MS, VECTOR_MS = 20.0, 0.5


class FarMstChain:
    """See :class:`gss.pipeline.chains.onboard.OnboardChain`."""

    name = NAME
    oldest_attitude_s = float("inf")

    def parameters(
        self, profile: CameraProfile, exposure_s: float | None, commanded: Commanded, mode: Mode
    ) -> FarMstParameters:
        return with_commanded(default_parameters(profile, exposure_s), profile.camera, commanded, mode)

    def prepare(self, catalogue: OnboardCatalogue, profile: CameraProfile) -> FarMstCatalogue:
        return far_mst_catalogue(catalogue, profile.camera)

    def find_centroids(self, pixels: Pixels, work: Work) -> Detection:
        return find_centroids(pixels, work.parameters)

    def match_stars(self, centroids: Centroids, work: Work) -> FarMstMatching:
        return match_stars(centroids, work.camera, work.catalogue, work.parameters, work.mode, work.hint)

    def calculate_attitude(self, matching: FarMstMatching, centroids: Centroids, work: Work) -> OnboardSolution:
        return far_mst.calculate_attitude(matching, centroids, work.camera, work.catalogue, work.parameters)

    def next_mode(self, mode: Mode, solved: bool) -> Mode:
        return next_mode(mode, solved)

    def detect_ms(self, pixels: int, detection: Detection) -> float:
        return PIXEL_MS * pixels + STAR_MS * len(detection.regions)

    def match_ms(self, matching: FarMstMatching) -> float:
        return MATCH_MS + ENTRY_MS * matching.operations

    def attitude_ms(self, matching: FarMstMatching) -> float:
        return ATTITUDE_MS + VECTOR_MS * len(matching.selected)
