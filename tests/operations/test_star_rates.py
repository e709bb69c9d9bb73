"""Angular rates from the stars of successive images, without a catalogue."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.cli import main
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.operations.frames.star_rate_sequence import StarRateSequencer
from gss.pipeline.render import render

STARS = load_stars(6.5)
PROFILE = shipped_camera("far_mst")
START = cam_from_icrs(1.4, 0.05, 0.3)
RATE_DEG_S = (0.3, -0.4, 0.6)


def frames(
    rate_deg_s: tuple[float, float, float], count: int = 3, interval_s: float = 1.0, trails: bool = True
) -> list[Array]:
    """Return images of a camera that rotates at a constant rate."""
    rate, camera, sensor = np.radians(rate_deg_s), PROFILE.camera, PROFILE.sensor
    return [
        render(
            STARS,
            camera,
            sensor,
            rotation_from_vector(-rate * interval_s * k) @ START,
            sensor.exposure_s,
            np.random.default_rng(k),
            rate_rad_s=rate * trails,
        ).pixels
        for k in range(count)
    ]


@pytest.mark.parametrize("rate_deg_s", [(0.0, 0.0, 0.0), RATE_DEG_S, (-1.0, 0.0, 0.0)])
@pytest.mark.parametrize("options", [{}, {"max_centroids": "3", "acceptance": "document"}])
def test_a_known_rate_is_measured_within_its_covariance(
    rate_deg_s: tuple[float, float, float], options: dict[str, str]
) -> None:
    """All stars, and the three brightest as in Table 1.3, give the rate within 5 σ, and within 70″ across and 1080″ in
    roll. The second rate uses the rate match."""
    sequencer = StarRateSequencer(PROFILE, 1.0, options=options)
    records = [sequencer.measure(image) for image in frames(rate_deg_s)]
    assert records[0]["rate"] is None
    assert [r["method"] for r in records[1:]] == ["triangle", "rate"]
    for record in records[1:]:
        rate, covariance = record["rate"], record["covariance_deg2_s2"]
        assert rate is not None
        error = np.array(rate["deg_s"]) - rate_deg_s
        assert error @ np.linalg.solve(np.array(covariance), error) < 25
        assert np.abs(np.radians(error)[:2]).max() < 70 * ARCSEC_RAD
        assert abs(np.radians(error)[2]) < 1080 * ARCSEC_RAD
        assert np.sqrt(np.diag(covariance)) == pytest.approx(rate["sigma_deg_s"])


def test_the_rate_scales_with_the_time_between_images() -> None:
    """Time stamps are used before the stated interval, also for intervals of different length."""
    sequencer, start = StarRateSequencer(PROFILE, 99.0), datetime(2026, 1, 1, tzinfo=UTC)
    images = frames(RATE_DEG_S, 4, 0.5)
    for k in (0, 1, 3):
        record = sequencer.measure(images[k], start + timedelta(seconds=0.5 * k))
    assert record["rate"] is not None
    assert record["rate"]["interval_s"] == 1.0
    assert record["method"] == "rate"
    assert record["rate"]["deg_s"] == pytest.approx(RATE_DEG_S, abs=0.02)


def test_equal_time_stamps_give_the_rate_of_the_stated_interval() -> None:
    """From the first two images with equal time stamps on, the stamps are too coarse, and the stated interval is used."""
    sequencer, start = StarRateSequencer(PROFILE, 0.5), datetime(2026, 1, 1, tzinfo=UTC)
    images = frames(RATE_DEG_S, 3, 0.5)
    records = [sequencer.measure(image, start + timedelta(seconds=k // 2)) for k, image in enumerate(images)]
    assert [r["rate"]["interval_s"] for r in records[1:] if r["rate"]] == [0.5, 0.5]


def test_a_rotation_without_a_unique_direction_gives_no_rate_and_the_next_pair_does() -> None:
    """A rotation of 175° between two images gives no rate, and the reason. The sequence continues."""
    still, turned = frames((0.0, 0.0, 175.0), 2, trails=False)
    sequencer = StarRateSequencer(PROFILE, 1.0)
    records = [sequencer.measure(image) for image in (still, turned, turned)]
    assert [r["rate"] is not None for r in records] == [False, False, True]
    assert "too large to determine its direction" in records[1]["reason"]


def test_images_without_common_stars_give_no_rate_and_the_next_pair_does() -> None:
    """A dark image gives no rate, and the reason. The sequence continues with the following images."""
    sequencer, images = StarRateSequencer(PROFILE, 1.0), frames(RATE_DEG_S, 4)
    images[1] = np.full_like(images[1], int(np.median(images[1])))
    records = [sequencer.measure(image) for image in images]
    assert [r["rate"] is not None for r in records] == [False, False, False, True]
    assert "too few stars" in records[1]["reason"]
    assert records[3]["method"] == "triangle"


def test_images_of_other_fields_give_no_rate() -> None:
    """Two images of different parts of the sky have no common rotation. The bound on accidental matches rejects it."""
    for k in range(4):
        sequencer = StarRateSequencer(PROFILE, 1.0)
        for ra_rad in (0.3 + k, 3.0 + k):
            rng, attitude = np.random.default_rng(k), cam_from_icrs(ra_rad, 0.1, 0.2)
            image = render(STARS, PROFILE.camera, PROFILE.sensor, attitude, PROFILE.sensor.exposure_s, rng).pixels
            record = sequencer.measure(image)
        assert record["rate"] is None
        assert record["reason"]


def test_missing_interval_and_wrong_size_are_rejected() -> None:
    """Without time stamps an interval is needed, and the images must fit the camera."""
    with pytest.raises(BadInput, match="above 0 s"):
        StarRateSequencer(PROFILE, 0.0)
    sequencer, images = StarRateSequencer(PROFILE), frames(RATE_DEG_S, 2)
    sequencer.measure(images[0])
    with pytest.raises(BadInput, match="time between two images is unknown"):
        sequencer.measure(images[1])
    with pytest.raises(BadInput, match="does not fit the camera"):
        sequencer.measure(images[0][:100])


def test_the_command_prints_the_rates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``gss rate`` prints one line or JSON object per image. The exit code reports a missing rate."""
    files = []
    for k, image in enumerate(frames(RATE_DEG_S)):
        files.append(str(tmp_path / f"{k}.png"))
        Image.fromarray(image).save(files[-1])
    command = ["rate", *files, "--camera", "far_mst", "--interval", "1"]
    assert main([*command, "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert records[2]["rate"]["deg_s"] == pytest.approx(RATE_DEG_S, abs=0.02)
    assert main(command) == 0
    assert "°/s about camera x, y, z" in capsys.readouterr().out
    Image.fromarray(np.full_like(image, 50)).save(files[2])
    assert main(command) == 3
    assert "no rate" in capsys.readouterr().out
    assert main(["rate", files[0], "--camera", "far_mst"]) == 2
