# ruff: noqa
"""A stand-in for the server: the contract's shapes with invented data. Development only."""

from __future__ import annotations

import asyncio
import io
import json
import os
import pathlib
import sys
from typing import Any

import numpy as np
import uvicorn
from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.responses import StreamingResponse
from mock_scene import CAMERA, IMAGE, RNG, STARS, attitude, iso, overlays, star_name
from PIL import Image

from gss.api.schemas import catalogues as c
from gss.api.schemas import commands as k
from gss.api.schemas import events as e
from gss.api.schemas import frames as f
from gss.api.schemas import jobs as j
from gss.api.schemas import link as li
from gss.api.schemas import sky as s
from gss.api.schemas import telemetry as t
from gss.api.schemas import transfers as tr

app = FastAPI(title="GSS console stand-in")
QUEUES: list[asyncio.Queue[tuple[int | None, str, str]]] = []
SEQ = [1200]
STAGES = ["queued", "released", "sent", "accepted", "started", "progress", "completed"]


def send(kind: str, item: Any, seq: int | None = None) -> None:
    for queue in QUEUES:
        queue.put_nowait((seq, kind, item.model_dump_json()))


def arg(
    name: str,
    kind: str,
    unit: str,
    low: float | None,
    high: float | None,
    default: Any,
    purpose: str,
    choices: list[tuple[str, int, str]] = [],
) -> dict:
    return dict(
        name=name,
        type=kind,
        unit=unit,
        purpose=purpose,
        min=low,
        max=high,
        default=default,
        choices=[dict(name=n, value=v, hazard=h, note="") for n, v, h in choices],
    )


def command(
    name: str,
    code: int,
    subsystem: str,
    purpose: str,
    hazard: str = "none",
    reason: str = "",
    args: list = [],
    favourite: bool = False,
    idem: bool = True,
    pre: list = [],
) -> dict:
    return dict(
        name=name,
        code=code,
        subsystem=subsystem,
        purpose=purpose,
        hazard=hazard,
        hazard_reason=reason,
        idempotent=idem,
        role="operator",
        favourite=favourite,
        arguments=args,
        preconditions=pre,
        accept_within_s=1.0,
        complete_within_s=5.0,
    )


BANK = arg("bank", "enum", "", None, None, "A", "which bank", [("A", 0, "none"), ("B", 1, "none"), ("C", 2, "none")])
PRE = [
    dict(text="mode is assisted or tracking", met=True, value="TRACKING"),
    dict(text="bank A verified from flash", met=True, value="18:36:15Z, SHA-256 7f21…09c0 equal"),
    dict(text="no transfer open", met=None, value="not known yet"),
]
COMMANDS = [
    command(
        "TAKE_IMAGE",
        0x10,
        "Imager",
        "Exposes one frame into an image slot.",
        favourite=True,
        args=[arg("slot", "u8", "", 0, 7, 0, "image slot")],
    ),
    command(
        "SET_EXPOSURE",
        0x11,
        "Imager",
        "Sets the exposure time of the next frames.",
        args=[arg("exposure", "f32", "ms", 1, 1000, 250, "exposure time")],
    ),
    command(
        "SET_DETECTION",
        0x12,
        "Detection",
        "Sets threshold and region size of the detector.",
        favourite=True,
        args=[
            arg("threshold", "u8", "DN", 0, 255, 22, "above background"),
            arg("min_pixels", "u8", "px", 1, 255, 6, "smallest region"),
            arg("max_pixels", "u8", "px", 1, 255, 60, "largest region"),
        ],
    ),
    command("FIND_CENTROIDS", 0x13, "Detection", "Finds regions and centroids in the last frame.", favourite=True),
    command("MATCH_STARS", 0x14, "Matching", "Matches the centroids with the active bank.", favourite=True),
    command("CALCULATE_ATTITUDE", 0x15, "Matching", "Computes the attitude from the matches.", favourite=True),
    command("RUN_ITERATION", 0x16, "Mode and cycle", "Runs one whole iteration.", favourite=True),
    command("START_CYCLE", 0x17, "Mode and cycle", "Runs iterations at 1 Hz until stopped."),
    command(
        "STOP_CYCLE",
        0x18,
        "Mode and cycle",
        "Stops the cycle after the current iteration.",
        "watch",
        "The attitude grows old.",
    ),
    command(
        "SET_MODE",
        0x19,
        "Mode and cycle",
        "Changes the mode.",
        "watch",
        "Matching behaves differently.",
        args=[
            arg(
                "mode",
                "enum",
                "",
                None,
                None,
                "standby",
                "new mode",
                [
                    ("standby", 0, "none"),
                    ("lost_in_space", 1, "none"),
                    ("assisted", 2, "none"),
                    ("tracking", 3, "none"),
                ],
            )
        ],
    ),
    command("GET_STATUS", 0x01, "Link", "Asks for the full status.", favourite=True),
    command("HELLO", 0x02, "Link", "Exchanges identity and dictionary hash."),
    command("LIST_BANKS", 0x30, "Banks", "Lists the flash banks."),
    command("VERIFY_BANK", 0x32, "Banks", "Reads a bank back and returns its hash.", args=[BANK]),
    command(
        "ACTIVATE_BANK",
        0x31,
        "Banks",
        "Makes a verified bank the one the matcher reads. The old bank is kept until you confirm the new one.",
        "critical",
        "The tracker loses its attitude until the first match with the new bank, about 2 s. Without confirmation in 120 s the device returns to the old bank by itself.",
        [BANK, arg("confirm_within", "u16", "s", 10, 600, 120, "time to confirm")],
        idem=False,
        pre=PRE,
    ),
    command(
        "CONFIRM_BANK",
        0x34,
        "Banks",
        "Keeps the activated bank.",
        "warning",
        "The old bank is no longer the fall-back.",
        [BANK],
    ),
    command(
        "RESET",
        0x40,
        "Mode and cycle",
        "Restarts the processor.",
        "warning",
        "The cycle stops and the frame memory is lost.",
        idem=False,
    ),
]
FIELDS = [
    ("sensor_temp", "Thermal", "Sensor temp.", "°C", 1, 46.2, "warning", (0, 45)),
    ("processor_temp", "Thermal", "Processor temp.", "°C", 1, 33.2, "ok", (0, 60)),
    ("imager_current", "Power", "Imager current", "mA", 1, 86.4, "ok", (20, 140)),
    ("rail_3v3", "Power", "3V3 rail", "V", 3, 3.291, "ok", (3.1, 3.5)),
    ("frame_background", "Imager", "Frame background", "DN", 2, 10.42, "ok", (2, 30)),
    ("match_confidence", "Matching", "Match confidence", "", 2, 0.97, "ok", (0.6, None)),
    ("attitude_age", "Attitude", "Attitude age", "s", 2, 0.42, "ok", (None, 5)),
    ("stars_matched", "Matching", "Stars matched", "", 0, 20, "ok", (3, None)),
    ("exposure", "Imager", "Exposure", "ms", 0, 250, "ok", (None, None)),
    ("threshold", "Detection", "Threshold", "DN", 0, 22, "ok", (None, None)),
    ("min_pixels", "Detection", "Region size, smallest", "px", 0, 6, "ok", (None, None)),
    ("max_pixels", "Detection", "Region size, largest", "px", 0, 60, "ok", (None, None)),
    ("iteration_count", "Attitude", "Iterations", "", 0, 1204, "ok", (None, None)),
    ("sram_current", "Power", "SRAM current", "mA", 1, 12.1, "stale", (5, 30)),
    ("housing_humidity", "Thermal", "Housing humidity", "%", 0, None, "never", (None, None)),
]


def definition(row: tuple) -> dict:
    name, page, title, unit, decimals, value, _, (low, high) = row
    span = (high or 1) - (low or 0)
    pair = lambda g: (None if low is None else low + g * span, None if high is None else high - g * span)  # noqa: E731
    return dict(
        name=name,
        packet="housekeeping",
        page=page,
        title=title,
        unit=unit,
        decimals=decimals,
        watch=pair(0.12),
        warning=pair(0.0),
        critical=pair(-0.12),
        stale_after_s=10,
    )


def value(row: tuple) -> dict:
    name, page, title, unit, decimals, v, state, _ = row
    now = None if v is None else v + (RNG.normal(0, abs(v) * 0.004) if decimals else 0)
    return dict(
        name=name,
        packet="housekeeping",
        title=title,
        page=page,
        raw=now,
        value=now,
        formatted="–" if now is None else f"{now:.{decimals}f}",
        unit=unit,
        state=state,
        text={"warning": "high", "stale": "stale 42 s", "never": "never received"}.get(state, state),
        at=None if now is None else iso(0.4),
        age_s=None if now is None else (42.0 if state == "stale" else 0.4),
    )


def made(
    i: int,
    name: str,
    ago: float,
    text: str = "",
    at: int = 6,
    state: str = "passed",
    result: str = "completed",
    detail: str = "",
) -> k.CommandOut:
    stages = [
        dict(
            name=n,
            state="passed" if x < at or (x == at and state == "passed") else (state if x == at else "to_come"),
            at=iso(ago - 0.03 * x) if x <= at else None,
        )
        for x, n in enumerate(STAGES)
    ]
    return k.CommandOut(
        id=i,
        request_id=0x12D0 + i,
        name=name,
        arguments={},
        text=text,
        user="operator-1",
        source="form",
        created=iso(ago),
        finished=iso(ago - 0.3),
        duration_s=0.21,
        stages=stages,
        result=result,
        detail=detail,
        late=False,
        attempts=1,
        resolved_note="",
        values={},
    )


HISTORY = [
    made(1, "TAKE_IMAGE", 700, "slot 3", 4, "failed", "failed", "imager latch-up, 214 mA"),
    made(2, "VERIFY_BANK", 500, "A"),
    made(3, "SET_MODE", 300, "tracking"),
    made(4, "START_CYCLE", 260, "1 Hz"),
    made(5, "SET_EXPOSURE", 200, "1 200 ms", 3, "failed", "rejected", "above 1 000 ms"),
    made(6, "SET_EXPOSURE", 180, "250 ms"),
    made(
        7,
        "SET_ATTITUDE_HINT",
        120,
        "RA 85.0°, Dec −0.3°",
        3,
        "unknown",
        "unknown",
        "No report before the 5.0 s window closed. The device may have run it or not.",
    ),
    made(8, "GET_STATUS", 60),
    made(9, "SET_DETECTION", 30, "threshold 22 DN, region size 6 – 60 px"),
]
DETAIL = overlays()


def solution(i: int, origin: str, chain: str, d: float, verdict: str | None = "correct", solved: bool = True) -> dict:
    return dict(
        id=i,
        frame_id=4812,
        origin=origin,
        chain=chain,
        version="1",
        created=iso(5),
        outcome="solved" if solved else "none",
        reason="" if solved else "2 of 8 stars in one group, 3 needed",
        attitude=attitude(d) if solved else None,
        found=21,
        matched=20 if solved else 0,
        rejected=7,
        rms_px=0.18 if d else 0.045,
        rms_arcsec=32.9 if d else 8.2,
        false_match_probability=None if d else 2e-11,
        fov_deg=(49.1, 25.7),
        timing_ms={} if origin == "on board" else {"detect": 1.4, "match": 2.2},
        verdict=verdict,
        error_axis_arcsec=6.4 if d else 1.7,
        error_roll_arcsec=13.2 if d else 2.9,
        replay="equal" if chain == "cubestar" and origin == "ground" else None,
        notes=[],
    )


SOLUTIONS = [
    solution(1, "on board", "cubestar", 0.0012),
    solution(2, "ground", "cubestar", 0.0012),
    solution(3, "ground", "reference", 0.0),
    solution(4, "ground", "sunsat", 0.0, None, False),
]


def frame(number: int) -> dict:
    return dict(
        id=number,
        number=number,
        slot=2,
        source="device" if number % 5 else "import",
        name=f"frame {number}",
        taken=iso(10 + 60 * (4812 - number)),
        received=iso(1 + 60 * (4812 - number)),
        columns=CAMERA.columns,
        rows=CAMERA.rows,
        bits=8,
        exposure_s=0.25,
        profile="cubestar",
        mode="tracking",
        sha256="4be1" + "0" * 56 + "77a0",
        complete=number != 4810,
        rows_held=[(0, 511)] if number != 4810 else [(0, 200), (240, 511)],
        contact_id=1,
        verdict="correct",
        outcome="solved" if number != 4809 else "none",
        chain="reference",
        matched=20,
        centroids=21,
        attitude=attitude() if number != 4809 else None,
    )


BANKS = [
    dict(
        bank="A",
        state="verified",
        active=False,
        catalogue_id=2,
        catalogue_name="zen-261205",
        stars=184,
        pairs=6232,
        sha256="7f21" + "0" * 60,
        valid_to=iso(-12 * 86400),
        days_left=12.0,
    ),
    dict(
        bank="B",
        state="active",
        active=True,
        catalogue_id=1,
        catalogue_name="zen-261121",
        stars=191,
        pairs=6613,
        sha256="11ab" + "0" * 60,
        valid_to=iso(-3.2 * 86400),
        days_left=3.2,
    ),
    dict(
        bank="C",
        state="empty",
        active=False,
        catalogue_id=None,
        catalogue_name=None,
        stars=None,
        pairs=None,
        sha256=None,
        valid_to=None,
        days_left=None,
    ),
]


def link() -> li.LinkOut:
    line = dict(state="up", age_s=0.2, error_rate=0.001, bytes=51234, frames=812, bad=0)
    return li.LinkOut(
        device="CubeStar twin 1",
        profile="cubestar",
        firmware="1.4.2",
        simulated=True,
        url="/dev/pts/4",
        connected=True,
        reason="",
        tx=dict(line, age_s=0.4, error_rate=0.0),
        rx=line,
        mode="TRACKING",
        cycle_running=True,
        active_bank=BANKS[1],
        banks=BANKS,
        dictionary_hash="9c41f2a7",
        device_dictionary_hash="9c41f2a7",
        dictionary_match=True,
        alarms=[
            dict(id="sensor_temp", level="warning", text="Sensor temp. high", since=iso(180)),
            dict(id="bank_valid", level="watch", text="Bank B valid for 3.2 d", since=iso(900)),
        ],
        contact_id=1,
        user="operator-1",
        role="Operator",
        authority="operator-1",
        utc=iso(),
    )


@app.get("/api/link")
def get_link() -> li.LinkOut:
    return link()


@app.post("/api/link/open")
def open_link(body: li.LinkOpenIn) -> li.LinkOut:
    return link()


@app.post("/api/link/close")
def close_link() -> li.LinkOut:
    return link()


@app.get("/api/dictionary")
def dictionary() -> k.DictionaryOut:
    return k.DictionaryOut(hash="9c41f2a7", commands=COMMANDS, telemetry=[definition(r) for r in FIELDS])


@app.get("/api/commands")
def commands(limit: int = 100, contact: int | None = None) -> list[k.CommandOut]:
    return HISTORY[::-1][:limit]


@app.post("/api/commands", status_code=201)
async def post_command(body: k.CommandIn) -> k.CommandOut:
    text = ", ".join(f"{a} {b}" for a, b in body.arguments.items())
    item = made(len(HISTORY) + 1, body.name, 0, text, 2, "now", "sent")
    HISTORY.append(item)

    async def finish() -> None:
        for at in (3, 4, 6):
            await asyncio.sleep(0.5)
            HISTORY[item.id - 1] = made(
                item.id, body.name, 0.5, text, at, "passed" if at == 6 else "now", "completed" if at == 6 else "started"
            )
            send("command", HISTORY[item.id - 1])

    asyncio.get_event_loop().create_task(finish())
    return item


@app.post("/api/commands/check")
def check(body: k.CommandIn) -> k.CheckOut:
    row = next((r for r in COMMANDS if r["name"] == body.name), None)
    if row is None:
        raise HTTPException(404)
    problems = [
        f"{a['name']}: {a['min']:g} – {a['max']:g}, got {body.arguments.get(a['name'])}"
        for a in row["arguments"]
        if a["max"] is not None and not (a["min"] <= float(body.arguments.get(a["name"], a["default"])) <= a["max"])
    ]
    return k.CheckOut(
        problems=problems,
        preconditions=row["preconditions"],
        size=24,
        bytes=[
            dict(label="packet header", hex="184dc0200011", argument=False),
            dict(label="type, dictionary, id, time", hex="029c41000012e86a2f", argument=False),
            dict(label="code", hex=f"{row['code']:02x}", argument=False),
            dict(
                label="arguments",
                hex="".join(
                    f"{int(float(v)) & 255 if isinstance(v, (int, float)) else 0:02x}" for v in body.arguments.values()
                ),
                argument=True,
            ),
            dict(label="CRC-32", hex="c419f70b", argument=False),
        ],
    )


@app.post("/api/commands/abort")
def abort() -> k.CommandOut:
    HISTORY.append(made(len(HISTORY) + 1, "ABORT", 0))
    send("command", HISTORY[-1])
    return HISTORY[-1]


@app.post("/api/commands/{i}/retry")
def retry(i: int) -> k.CommandOut:
    return HISTORY[i - 1]


@app.post("/api/commands/{i}/resolve")
def resolve(i: int, body: k.ResolveIn) -> k.CommandOut:
    HISTORY[i - 1].resolved_note = body.note
    return HISTORY[i - 1]


@app.get("/api/telemetry/latest")
def latest() -> t.LatestOut:
    return t.LatestOut(values=[value(r) for r in FIELDS])


@app.get("/api/telemetry/history")
def history(start: str, end: str, points: int = 600, name: str = "") -> t.HistoryOut:
    return t.HistoryOut(start=iso(600), end=iso(), series=[])


CYCLES = [
    t.CycleOut(
        iteration=1204 - i,
        at=iso(i),
        capture_ms=250,
        transfer_ms=182,
        detect_ms=154 + (120 if i == 4 else RNG.integers(0, 9)),
        match_ms=10,
        attitude_ms=6,
        total_ms=602 + (120 if i == 4 else RNG.integers(0, 9)),
    )
    for i in range(12)
]


@app.get("/api/telemetry/cycles")
def cycles(limit: int = 12) -> list[t.CycleOut]:
    return CYCLES


@app.get("/api/frames")
def frames(limit: int = 50, offset: int = 0, source: str = "", outcome: str = "", mode: str = "") -> f.FramePage:
    rows = [frame(n) for n in range(4812, 4792, -1)]
    rows = [r for r in rows if (not source or r["source"] == source) and (not outcome or r["outcome"] == outcome)]
    return f.FramePage(total=len(rows), frames=rows[offset : offset + limit])


@app.get("/api/frames/latest")
def latest_frame() -> f.FrameDetailOut:
    return frame_detail(4812)


@app.get("/api/frames/{i}")
def frame_detail(i: int) -> f.FrameDetailOut:
    both = i != 4809
    return f.FrameDetailOut(
        **frame(i),
        solutions=SOLUTIONS,
        on_board=SOLUTIONS[0] | DETAIL if both else None,
        ground=SOLUTIONS[2] | DETAIL if both else None,
        truth=attitude(),
        comparison=dict(
            d_ra_arcsec=-2.4,
            d_dec_arcsec=-6.5,
            d_roll_arcsec=16.2,
            cross_arcsec=6.9,
            agree=True,
            text="on board and ground agree",
        )
        if both
        else None,
    )


@app.get("/api/frames/{i}/raw")
def raw(i: int) -> Response:
    return Response(
        IMAGE.tobytes(),
        media_type="application/octet-stream",
        headers={"X-Columns": "1024", "X-Rows": "512", "X-Bits": "8"},
    )


@app.get("/api/frames/{i}/thumbnail.png")
@app.get("/api/frames/{i}/image.png")
def png(i: int) -> Response:
    out = io.BytesIO()
    Image.fromarray(np.clip((IMAGE.astype(float) - 10) * 5, 0, 255).astype(np.uint8)).resize((256, 128)).save(
        out, "PNG"
    )
    return Response(out.getvalue(), media_type="image/png")


@app.get("/api/frames/{i}/pixels")
def pixels(i: int, col: int, row: int, columns: int, rows: int) -> f.PixelsOut:
    return f.PixelsOut(
        col=col, row=row, columns=columns, rows=rows, values=IMAGE[row : row + rows, col : col + columns].tolist()
    )


@app.get("/api/frames/{i}/histogram")
def histogram(i: int) -> f.HistogramOut:
    counts, edges = np.histogram(IMAGE, bins=128, range=(0, 255))
    return f.HistogramOut(edges=edges.tolist(), counts=counts.tolist(), low=9, high=96)


@app.post("/api/frames/import", status_code=201)
async def import_frame(request: Request) -> f.FrameDetailOut:
    return frame_detail(4805)


@app.post("/api/frames/{i}/solve")
def solve(i: int, body: f.SolveIn) -> f.SolutionDetailOut:
    return f.SolutionDetailOut(**(SOLUTIONS[2] | DETAIL | {"id": 3}))


@app.get("/api/solutions/{i}")
def one_solution(i: int) -> f.SolutionDetailOut:
    return f.SolutionDetailOut(**(next(x for x in SOLUTIONS if x["id"] == i) | DETAIL))


@app.post("/api/frames/download")
def download(body: f.DownloadIn) -> tr.TransferOut:
    return TRANSFER


def sky_stars() -> list[dict]:
    keep = STARS.v_mag <= 4.5
    v, m, hip = STARS.icrs[keep], STARS.v_mag[keep], STARS.hip[keep]
    return [
        dict(
            hip=int(h),
            name=star_name(h),
            ra_deg=float(np.degrees(np.arctan2(q[1], q[0])) % 360),
            dec_deg=float(np.degrees(np.arcsin(q[2]))),
            v_mag=float(w),
        )
        for h, q, w in zip(hip, v, m, strict=True)
    ]


@app.get("/api/sky")
def sky(mag: float = 4.5) -> s.SkyOut:
    return s.SkyOut(
        utc=iso(),
        stars=sky_stars(),
        bodies=[
            dict(name="Sun", ra_deg=248.0, dec_deg=-21.9, exclusion_deg=40),
            dict(name="Moon", ra_deg=165.0, dec_deg=6.0, exclusion_deg=20),
        ],
    )


@app.get("/api/profiles")
def profiles() -> list[s.ProfileOut]:
    return [
        s.ProfileOut(
            name="cubestar",
            title="CubeStar (Erlank 2013)",
            columns=1024,
            rows=512,
            fov_deg=(49.1, 25.7),
            focal_mm=6.28,
            faint_mag=3.8,
            bits=8,
            formats=["cubestar"],
        ),
        s.ProfileOut(
            name="sunsat",
            title="Sunsat (Jacobs 1995)",
            columns=750,
            rows=288,
            fov_deg=(14.2, 10.4),
            focal_mm=35,
            faint_mag=6,
            bits=8,
            formats=["sunsat", "cubestar"],
        ),
    ]


def map_of(body: dict) -> dict:
    from astropy_healpix import HEALPix

    hp = HEALPix(16, "ring")
    lon, lat = hp.healpix_to_lonlat(np.arange(hp.npix))
    ra, dec = np.degrees(lon.value) % 360, np.degrees(lat.value)
    band = np.exp(-(((np.hypot((ra - 150) * np.cos(np.radians(dec)), dec)) - 55) ** 2) / (2 * 15**2)) * 0.16
    band[band < 0.004] = 0
    sky_all = []
    for q in sky_stars():
        inside = band[hp.lonlat_to_healpix(np.radians(q["ra_deg"]) * lon.unit, np.radians(q["dec_deg"]) * lon.unit)] > 0
        state = (
            "outside"
            if not inside or q["v_mag"] > body.get("faint_mag", 3.8)
            else ("rejected" if q["hip"] % 23 == 0 else "thinned" if q["hip"] % 7 == 0 else "kept")
        )
        sky_all.append({x: q[x] for x in ("hip", "ra_deg", "dec_deg", "v_mag")} | {"state": state})
    circle = lambda r: [
        (float((150 + r * np.cos(x) / np.cos(np.radians(r * np.sin(x) * 0.98))) % 360), float(r * np.sin(x) * 0.98))
        for x in np.linspace(0, 2 * np.pi, 90)
    ]  # noqa: E731
    return dict(
        sky=sky_all,
        envelope=dict(
            nside=16,
            fraction=band.tolist(),
            outline_start=[circle(75), circle(25)],
            outline_end=[circle(78), circle(22)],
        ),
    )


FUNNEL = [
    dict(label=a, stars=b, kind=d)
    for a, b, d in [
        ("Hipparcos", 117955, "keep"),
        ("V ≤ 4.00", 519, "keep"),
        ("inside the envelope", 249, "keep"),
        ("close doubles", 9, "drop"),
        ("variable", 2, "drop"),
        ("beyond 10 per field", 53, "drop"),
        ("kept", 184, "keep"),
    ]
]


@app.post("/api/catalogues/preview")
def preview(body: c.CatalogueIn) -> c.PreviewOut:
    return c.PreviewOut(
        stars=184, pairs_estimate=6232, bytes_estimate=52640, funnel=FUNNEL, elapsed_ms=84, **map_of(body.model_dump())
    )


CATALOGUES = [
    dict(
        id=i,
        name=n,
        profile="cubestar",
        format="cubestar",
        created=iso(86400 * d),
        author="catalogue-1",
        stars=st,
        pairs=p,
        bytes=b,
        sha256=h + "0" * 60,
        valid_from=iso(86400 * d),
        valid_to=None if v is None else iso(-86400 * v),
        banks=bk,
    )
    for i, n, d, st, p, b, h, v, bk in [
        (1, "zen-261121", 11, 191, 6613, 53210, "11ab", 3.2, ["B"]),
        (2, "zen-261205", 1, 184, 6232, 52640, "7f21", 17, ["A"]),
        (3, "all-sky-38", 300, 405, 20111, 121000, "aa00", None, []),
    ]
]


@app.get("/api/catalogues")
def catalogues() -> list[c.CatalogueOut]:
    return [c.CatalogueOut(**x) for x in CATALOGUES]


@app.get("/api/catalogues/{i}")
def catalogue(i: int) -> c.CatalogueDetailOut:
    hist = [
        0,
        1,
        4,
        30,
        90,
        140,
        220,
        260,
        250,
        300,
        320,
        370,
        390,
        400,
        380,
        350,
        330,
        260,
        220,
        190,
        160,
        120,
        80,
        60,
        40,
        20,
        10,
        4,
        2,
    ]
    quality = dict(
        pointings=30000,
        histogram=hist,
        mean=14.0,
        p_fewer_than_3=0.0002,
        p_fewer_than_5=0.0146,
        worst_stars=2,
        worst_ra_deg=113.6,
        worst_dec_deg=58.9,
        candidates_per_query=3.8,
    )
    return c.CatalogueDetailOut(
        **CATALOGUES[i - 1],
        request=dict(c.CatalogueIn(name="x", orbit="elements").model_dump()),
        manifest={"format": "cubestar", "sections": {"stars": 2560, "distances": 49868, "index": 212}},
        funnel=FUNNEL,
        quality=quality,
        **map_of({}),
    )


JOBS: list[j.JobOut] = []


@app.post("/api/catalogues", status_code=202)
async def build(body: c.CatalogueIn) -> j.JobOut:
    job = j.JobOut(
        id=len(JOBS) + 1,
        kind="catalogue",
        title=f"build {body.name}",
        state="running",
        done=0,
        total=20,
        text="envelope",
        created=iso(),
        finished=None,
        result={},
    )
    JOBS.append(job)

    async def run() -> None:
        for done in range(1, 21):
            await asyncio.sleep(0.2)
            if job.state == "cancelled":
                break
            job.done, job.text = done, "distances" if done > 8 else "envelope"
            if done == 20:
                job.state, job.result = "done", {"catalogue_id": 2}
            send("job", job)

    asyncio.get_event_loop().create_task(run())
    return job


TRANSFER = tr.TransferOut(
    id=1,
    direction="up",
    kind="catalogue",
    target="A",
    subject="zen-261205",
    state="transferring",
    reason="",
    size=52640,
    chunk_size=256,
    chunks=206,
    stored=[(0, 96), (103, 120), (122, 145)],
    stored_bytes=36096,
    resent=7,
    rate_bytes_s=880,
    line_share=0.92,
    left_s=19,
    sha256="7f21",
    created=iso(60),
    finished=None,
    frame_id=None,
    catalogue_id=2,
    log=[
        "18:41:22Z link lost for 6.2 s, chunks 97 – 102 not stored",
        "18:41:29Z resumed, device holds 0 – 96, same hash and slot",
    ],
)


@app.post("/api/catalogues/{i}/upload")
def upload(i: int, body: c.UploadIn) -> tr.TransferOut:
    return TRANSFER


@app.get("/api/transfers")
def transfers(limit: int = 20) -> list[tr.TransferOut]:
    return [TRANSFER]


@app.get("/api/transfers/{i}")
def transfer(i: int) -> tr.TransferOut:
    return TRANSFER


@app.post("/api/transfers/{i}/{action}")
def act(i: int, action: str) -> tr.TransferOut:
    TRANSFER.state = {"pause": "paused", "resume": "transferring", "abort": "aborted"}[action]
    return TRANSFER


@app.get("/api/jobs")
def jobs() -> list[j.JobOut]:
    return JOBS


@app.get("/api/jobs/{i}")
def job(i: int) -> j.JobOut:
    return JOBS[i - 1]


@app.post("/api/jobs/{i}/cancel")
def cancel(i: int) -> j.JobOut:
    JOBS[i - 1].state = "cancelled"
    return JOBS[i - 1]


def event(seq: int, ago: float = 0) -> e.EventOut:
    return e.EventOut(
        seq=seq, at=iso(ago), kind="iteration", severity="info", text=f"iteration {seq} solved, 20 stars", data={}
    )


@app.get("/api/events")
def events(after: int = 0, limit: int = 200) -> list[e.EventOut]:
    return [event(x, SEQ[0] - x) for x in range(max(after + 1, SEQ[0] - 5), SEQ[0] + 1)]


@app.get("/api/contacts")
def contacts() -> list[e.ContactOut]:
    return [
        e.ContactOut(
            id=1,
            device="CubeStar twin 1",
            url="/dev/pts/4",
            started=iso(2400),
            ended=None,
            rx_bytes=5123400,
            tx_bytes=20111,
            frames=31,
            commands=9,
        )
    ]


@app.get("/api/rerun/{name}")
def viewer(name: str) -> Response:
    folder = os.environ.get("GSS_MOCK_VIEWER", "")
    path = pathlib.Path(folder) / name
    if not folder or name not in ("re_viewer.js", "re_viewer_bg.wasm") or not path.exists():
        raise HTTPException(404)
    return Response(path.read_bytes(), media_type="text/javascript" if name.endswith("js") else "application/wasm")


@app.get("/api/frames/{i}/recording.rrd")
def rrd(i: int) -> Response:
    import rerun as rr

    stream = rr.RecordingStream("gss")
    memory = stream.binary_stream()
    stream.set_time("frame", sequence=i)
    stream.log("camera/image", rr.Image(IMAGE))
    return Response(memory.read() or b"", media_type="application/octet-stream")


@app.get("/api/health")
def health() -> dict:
    return {"status": "ok"}


@app.get("/api/stream")
async def stream() -> StreamingResponse:
    queue: asyncio.Queue = asyncio.Queue()
    QUEUES.append(queue)

    async def body():  # type: ignore[no-untyped-def]
        try:
            while True:
                seq, kind, data = await queue.get()
                yield (f"id: {seq}\n" if seq else "") + f"event: {kind}\ndata: {data}\n\n"
        finally:
            QUEUES.remove(queue)

    return StreamingResponse(body(), media_type="text/event-stream")


async def tick() -> None:
    while True:
        await asyncio.sleep(1)
        SEQ[0] += 1
        send("link", link())
        send("telemetry", latest())
        send("event", event(SEQ[0]), SEQ[0])


@app.on_event("startup")
async def start() -> None:
    asyncio.get_event_loop().create_task(tick())


if __name__ == "__main__":
    if sys.argv[1:2] == ["openapi"]:
        print(json.dumps(app.openapi(), indent=1))
    else:
        uvicorn.run(app, host="127.0.0.1", port=int(sys.argv[1]), log_level="warning")
