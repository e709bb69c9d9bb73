"""Table of all experiments."""

from __future__ import annotations

from gss.domain.experiment import ExperimentEntry
from validation.erlank.attitude import erlank_4_4b
from validation.erlank.budgets import erlank_budgets
from validation.erlank.catalogue import erlank_3_6, erlank_fig_3_8
from validation.erlank.centroids import erlank_4_1_6
from validation.erlank.matching import erlank_4_4, erlank_4_5
from validation.erlank.night import erlank_6_1
from validation.erlank.slew import erlank_6_2
from validation.health.mission import mission
from validation.huffman.attitude import huffman_6
from validation.huffman.catalogue import huffman_5_1, huffman_5_5
from validation.huffman.centroids import huffman_4_2, huffman_4_4
from validation.huffman.detection import huffman_7_2
from validation.huffman.magnitudes import huffman_5_3
from validation.huffman.matching import huffman_8_2
from validation.huffman.rates import huffman_1_3
from validation.huffman.triangles import huffman_5_4
from validation.jacobs.calibration import jacobs_6
from validation.jacobs.catalogue import jacobs_5_1, jacobs_5_2
from validation.jacobs.errors import jacobs_6_1
from validation.jacobs.matching import jacobs_3_7
from validation.jacobs.tracking import jacobs_fig_2_7, jacobs_tracking
from validation.liebe.key_numbers import liebe_4
from validation.liebe.tables import liebe_2, liebe_3, liebe_18
from validation.moniteq.budgets import moniteq_2_3, moniteq_budgets
from validation.moniteq.differential import moniteq_differential
from validation.moniteq.locator import moniteq_4_2, moniteq_nea, moniteq_noise
from validation.moniteq.screening import moniteq_screening
from validation.moniteq.sky import moniteq_2_1, moniteq_links
from validation.moving.objects import moving_objects
from validation.never_wrong.probability import false_match
from validation.never_wrong.table import never_wrong
from validation.sheet.injection import injection
from validation.shipped.units import shipped_units

ENTRIES: dict[str, ExperimentEntry] = {
    e.name: e
    for e in (
        ExperimentEntry("jacobs-5-1", "Stars in a Sunsat image", jacobs_5_1, 1_000_000, 1991.25),
        ExperimentEntry("jacobs-5-2", "Sizes of Sunsat's sub-catalogues", jacobs_5_2, 1, 1991.25),
        ExperimentEntry("jacobs-3-7", "Sunsat's matching: correct, none, wrong", jacobs_3_7, 400, 1991.25),
        ExperimentEntry("jacobs-6", "Calibration of Sunsat's camera", jacobs_6, 20, 1991.25),
        ExperimentEntry("jacobs-6-1", "Errors by focal length, optical centre and TRIAD", jacobs_6_1, 1, 1991.25),
        ExperimentEntry("jacobs-tracking", "Tracking among false stars", jacobs_tracking, 100, 1991.25),
        ExperimentEntry("jacobs-fig-2-7", "Cost of region growing against area", jacobs_fig_2_7, 20, 1991.25),
        ExperimentEntry("erlank-3-6", "Sky coverage against limiting magnitude", erlank_3_6, 20_000),
        ExperimentEntry("erlank-fig-3-8", "Sky coverage by field and magnitude", erlank_fig_3_8, 20_000),
        ExperimentEntry("erlank-budgets", "Bank, frame times and power of the unit", erlank_budgets, 1),
        ExperimentEntry("erlank-4-1-6", "Centroid error on artificial images", erlank_4_1_6, 300),
        ExperimentEntry("erlank-4-4", "Matching against magnitude cutoff", erlank_4_4, 500),
        ExperimentEntry("erlank-4-5", "Matching among false stars", erlank_4_5, 500),
        ExperimentEntry("erlank-4-4b", "Best-case accuracy of the attitude", erlank_4_4b, 300),
        ExperimentEntry("erlank-6-1", "Accuracy of an Earth-fixed camera", erlank_6_1, 100),
        ExperimentEntry("erlank-6-2", "Tracking while slewing", erlank_6_2, 4),
        ExperimentEntry("huffman-1-3", "LIST: rates from stars without a catalogue", huffman_1_3, 50),
        ExperimentEntry("huffman-4-2", "Maximum likelihood against weighted sum", huffman_4_2, 10),
        ExperimentEntry("huffman-4-4", "Centroid error against PSF width and SNR", huffman_4_4, 2_000),
        ExperimentEntry("huffman-5-1", "Limiting magnitude for a number of stars", huffman_5_1, 10_000),
        ExperimentEntry("huffman-5-3", "Magnitudes measured from frames", huffman_5_3, 25),
        ExperimentEntry("huffman-5-4", "Area and polar moment of star triangles", huffman_5_4, 1_000),
        ExperimentEntry("huffman-5-5", "The eight brightest of every field", huffman_5_5, 10_000),
        ExperimentEntry("huffman-6", "Attitude methods on a tumbling camera", huffman_6, 1_000),
        ExperimentEntry("huffman-7-2", "Two centroiders at five thresholds", huffman_7_2, 6),
        ExperimentEntry("huffman-8-2", "Matching algorithms on sequences", huffman_8_2, 20),
        ExperimentEntry("liebe-2", "Correct initial estimates by kind of error", liebe_2, 500, 1994.95),
        ExperimentEntry("liebe-3", "Accuracy of the predictional estimate by kind of error", liebe_3, 500, 1994.95),
        ExperimentEntry("liebe-18", "Accuracy of the boresight against the number of stars", liebe_18, 10_000, 1994.95),
        ExperimentEntry("liebe-4", "Key numbers: database and averaged estimates", liebe_4, 10, 1994.95),
        ExperimentEntry("moniteq-2-1", "Stars by magnitude and in a field", moniteq_2_1, 10_000),
        ExperimentEntry("moniteq-2-3", "Star density by galactic latitude", moniteq_2_3, 1),
        ExperimentEntry("moniteq-budgets", "Budgets of heat, power and mass", moniteq_budgets, 1),
        ExperimentEntry("moniteq-4-2", "Systematic error of the mean locator", moniteq_4_2, 1),
        ExperimentEntry("moniteq-noise", "Noise of the mean locator", moniteq_noise, 60_000),
        ExperimentEntry("moniteq-nea", "Noise equivalent angle against orbital rate", moniteq_nea, 1),
        ExperimentEntry(
            "moniteq-differential", "Differential attitude with one and two cameras", moniteq_differential, 2_000
        ),
        ExperimentEntry("moniteq-links", "Following links against searching the list", moniteq_links, 500),
        ExperimentEntry(
            "moniteq-screening", "False matches by chance, and stars to screen out", moniteq_screening, 9_000
        ),
        ExperimentEntry("shipped-units", "The five units as shipped", shipped_units, 1000, 2026.0),
        ExperimentEntry("sheet-injection", "Performance sheet: each error alone", injection, 40),
        ExperimentEntry("moving-objects", "Moving objects: satellites detected in frames", moving_objects, 300, 2026.0),
        ExperimentEntry("mission-health", "Health over a simulated year", mission, 500, 2026.0),
        ExperimentEntry("false-match", "False-match probability: limit and observed share", false_match, 2_000),
        ExperimentEntry("never-wrong", "False attitudes under every fault", never_wrong, 30),
    )
}
