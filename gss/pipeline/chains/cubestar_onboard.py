"""CubeStar's chain on the device. Commanded values replace its parameters; durations are from the document."""

from __future__ import annotations

from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Centroids
from gss.pipeline.chains import cubestar
from gss.pipeline.chains.cubestar_match import CubestarMatching
from gss.pipeline.chains.cubestar_parameters import CubestarParameters, default_parameters
from gss.pipeline.chains.modes import Mode, next_mode
from gss.pipeline.chains.onboard import Commanded, Detection, OnboardSolution, Work, with_commanded
from gss.pipeline.regions import Pixels
from gss.skytables.bank import OnboardCatalogue

# Erlank 2013 §5.3.3–5.3.6: 320 ms for twenty centroids, under 10 ms for QUEST.
SAMPLE_MS, REGION_MS = 0.001, 1.0
PAIR_MS, HIT_MS, ATTITUDE_MS, VECTOR_MS = 0.05, 0.02, 7.0, 0.1


class CubestarChain:
    """See :class:`gss.pipeline.chains.onboard.OnboardChain`."""

    name = cubestar.NAME
    oldest_attitude_s = float("inf")

    def parameters(
        self, profile: CameraProfile, exposure_s: float | None, commanded: Commanded, mode: Mode
    ) -> CubestarParameters:
        return with_commanded(default_parameters(profile, exposure_s), profile.camera, commanded, mode)

    def prepare(self, catalogue: OnboardCatalogue, profile: CameraProfile) -> OnboardCatalogue:
        catalogue.need_distances()
        return catalogue

    def find_centroids(self, pixels: Pixels, work: Work) -> Detection:
        return cubestar.find_centroids(pixels, work.parameters)

    def match_stars(self, centroids: Centroids, work: Work) -> CubestarMatching:
        return cubestar.match_stars(centroids, work.camera, work.catalogue, work.parameters, work.mode, work.hint)

    def calculate_attitude(self, matching: CubestarMatching, centroids: Centroids, work: Work) -> OnboardSolution:
        return cubestar.calculate_attitude(matching, centroids, work.camera, work.catalogue, work.parameters, work.hint)

    def next_mode(self, mode: Mode, solved: bool) -> Mode:
        return next_mode(mode, solved)

    def detect_ms(self, pixels: int, detection: Detection) -> float:
        return SAMPLE_MS * pixels / 9 + REGION_MS * (len(detection.centroids) + detection.invalid)

    def match_ms(self, matching: CubestarMatching) -> float:
        n = len(matching.row)
        return PAIR_MS * n * (n - 1) + HIT_MS * matching.hits

    def attitude_ms(self, matching: CubestarMatching) -> float:
        return ATTITUDE_MS + VECTOR_MS * len(matching.selected)
