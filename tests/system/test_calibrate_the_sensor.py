"""A simulated sensor with a wrong lens model is calibrated from its own frames, through a real server."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.timeout(300)
LENS_OFF_PERCENT = 0.5
FRAMES = 8


def look(console, attitudes) -> list[int]:
    """Frames of as many places of the sky, worked on by the sensor itself, with everything about them at hand."""
    made = []
    for ra_deg, dec_deg, roll_deg in attitudes:
        console.command("SIM_SET_SKY", motion="inertial", ra_deg=ra_deg, dec_deg=dec_deg, roll_deg=roll_deg)
        console.command("SET_MODE", mode="lost_in_space")
        console.command("RUN_ITERATION")

        def arrived(known=tuple(made)):
            rows = [
                f
                for f in console.get("/frames", limit=500)["frames"]
                if f["complete"] and f["id"] > max(known, default=0)
            ]
            return rows[0]["id"] if rows else None

        made.append(console.wait("the frame", arrived, 40))
    return made


def judged(console, ids: list[int]) -> tuple[int, list[int]]:
    """(frames solved on board, stars matched in each); every replay on the ground must be equal."""
    solved, matched = 0, []
    for frame_id in ids:
        frame = console.wait(
            "the replay",
            lambda i=frame_id: next(
                (f for f in [console.get(f"/frames/{i}")] if (f["on_board"] or {}).get("replay")), None
            ),
            40,
        )
        said = frame["on_board"]
        assert said["replay"] == "equal", (frame_id, said["replay"])
        solved += said["outcome"] == "solved"
        matched.append(sum(s.get("hip") is not None for s in said["stars"]) if said["outcome"] == "solved" else 0)
    return solved, matched


def places(count: int, seed: int) -> list[tuple[float, float, float]]:
    rng = np.random.default_rng(seed)
    ra, dec, roll = (
        rng.uniform(0, 360, count),
        np.degrees(np.arcsin(rng.uniform(-1, 1, count))),
        rng.uniform(0, 360, count),
    )
    return list(zip(ra.tolist(), dec.tolist(), roll.tolist(), strict=True))


def test_a_sensor_matches_better_after_its_own_frames_calibrated_it(serve):
    """From frames to an active, confirmed table: more attitudes and more stars on board, and replays equal before and after."""
    options = {"GSS_SIMULATOR_OPTIONS": f"--lens-off {LENS_OFF_PERCENT}"}
    console = serve("--simulator", "cubestar", **options).console
    console.wait("the sensor", lambda: (console.get("/link")["active_bank"] or {}).get("catalogue_id"), 60)
    console.wait("the tables on board", lambda: console.get("/tables/on-board"))

    first = look(console, places(FRAMES, 1))
    before, stars_before = judged(console, first)
    body = {"kind": "stars", "profile": "cubestar", "frame_ids": first, "models": ["brown-4"], "psf": False}
    job = console.post("/calibrations", body, status=202)

    def done():
        row = next(j for j in console.get("/jobs") if j["id"] == job["id"])
        assert row["state"] not in ("failed", "cancelled"), row["text"]
        return row if row["state"] == "done" else None

    made = console.get(f"/calibrations/{console.wait('the calibration', done, 120)['result']['calibration_id']}")
    plain = console.get("/tables/defaults", kind="calibration", profile="cubestar")["content"]
    assert made["values"]["focal_col_px"] / plain["focal_col_px"] == pytest.approx(1 + LENS_OFF_PERCENT / 100, abs=4e-4)

    table = console.post(f"/calibrations/{made['id']}/table")
    transfer = console.post(f"/tables/{table['id']}/upload", {"bank": "A"})

    def committed():
        row = console.get(f"/transfers/{transfer['id']}")
        assert row["state"] not in ("failed", "aborted"), row["reason"]
        return row["state"] == "committed"

    console.wait("the table to be committed", committed, 60)
    for name, more in (("VERIFY_TABLE", {"bank": "A"}), ("ACTIVATE_TABLE", {"bank": "A"}), ("CONFIRM_TABLE", {})):
        ended = console.command(name, confirm=name, table="calibration", **more)
        assert ended["result"] == "completed", (name, ended["detail"])
    console.wait(
        "the calibration to be on the sensor",
        lambda: any("active" in p for p in console.get(f"/calibrations/{made['id']}")["places"]),
    )

    after, stars_after = judged(console, look(console, places(FRAMES, 1)))
    assert after >= before + 3
    assert np.mean(stars_after) > 2 * np.mean(stars_before)
