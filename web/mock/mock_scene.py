# ruff: noqa
"""An invented frame and its overlays, through the project's own camera model."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from gss.catalogue_tools.hipparcos import load_stars
from gss.domain.frames import cam_from_icrs
from gss.domain.profiles import profile
from gss.domain.rotation import quaternion_from_matrix

CAMERA = profile("cubestar").camera
RA, DEC, ROLL = 85.0437, -0.3116, 313.4174
ATTITUDE = cam_from_icrs(*np.radians([RA, DEC, ROLL]))
STARS = load_stars(6.0)
RNG = np.random.default_rng(7)


def iso(seconds_ago: float = 0) -> datetime:
    return datetime.fromtimestamp(datetime.now(UTC).timestamp() - seconds_ago, UTC)


def star_name(hip: int) -> str:
    return STARS.names.get(int(hip), f"HIP {hip}")


def visible(limit: float) -> list[tuple[int, float, float, float]]:
    keep = STARS.v_mag <= limit
    pixels = CAMERA.project(STARS.icrs[keep] @ ATTITUDE.T)
    inside = CAMERA.contains(pixels, 2)
    return [
        (int(h), float(v), float(c), float(r))
        for h, v, (c, r) in zip(STARS.hip[keep][inside], STARS.v_mag[keep][inside], pixels[inside], strict=True)
    ]


def image() -> np.ndarray:
    out = RNG.normal(10.4, 1.6, (CAMERA.rows, CAMERA.columns))
    y, x = np.mgrid[-6:7, -6:7]
    for _, v, col, row in visible(6.0):
        c, r = round(col), round(row)
        if 7 < c < CAMERA.columns - 8 and 7 < r < CAMERA.rows - 8:
            spot = np.exp(-((x - (col - c)) ** 2 + (y - (row - r)) ** 2) / (2 * 1.2**2))
            out[r - 6 : r + 7, c - 6 : c + 7] += 1100 * 10 ** (-0.4 * v) * spot
    return np.clip(out, 0, 255).astype(np.uint8)


IMAGE = image()


def attitude(d: float = 0.0) -> dict:
    m = cam_from_icrs(*np.radians([RA + d, DEC - d, ROLL + 2 * d]))
    return dict(
        ra_deg=RA + d,
        dec_deg=DEC - d,
        roll_deg=ROLL + 2 * d,
        quaternion=tuple(quaternion_from_matrix(m)),
        sigma_cross_arcsec=None if d else 4.1,
        sigma_roll_arcsec=None if d else 13.6,
    )


def line(label: str, ra: np.ndarray, dec: np.ndarray) -> dict | None:
    r, d = np.radians(ra), np.radians(dec)
    v = np.stack([np.cos(d) * np.cos(r), np.cos(d) * np.sin(r), np.sin(d) + 0 * r], -1)
    p = CAMERA.project(v @ ATTITUDE.T)
    ok = CAMERA.contains(p, -20)
    return dict(label=label, points=[tuple(map(float, q)) for q in p[ok]]) if ok.sum() > 1 else None


def overlays() -> dict:
    stars, predicted, regions = [], [], []
    for i, (hip, v, col, row) in enumerate(visible(3.9)):
        bad = hip == 32349 or i % 7 == 6
        predicted.append(dict(hip=hip, name=star_name(hip), v_mag=v, col_px=col, row_px=row, detected=not bad))
        half = 2 + max(0, int(3 - v))
        regions.append(
            dict(
                col_min=round(col) - half,
                row_min=round(row) - half,
                col_max=round(col) + half,
                row_max=round(row) + half,
                area_px=66 if hip == 32349 else 12 + 4 * half,
                peak_dn=180.0,
                rejected=("area 66 px > max 60" if hip == 32349 else "area 4 px < min 6") if bad else "",
            )
        )
        if not bad:
            dx, dy = RNG.normal(0, 0.05, 2)
            stars.append(
                dict(
                    index=len(stars),
                    col_px=col + dx,
                    row_px=row + dy,
                    flux_dn=1000 * 10 ** (-0.4 * (v - 2)),
                    peak_dn=90.0,
                    area_px=12 + 4 * half,
                    hip=hip,
                    name=star_name(hip),
                    v_mag=v,
                    dx_px=dx,
                    dy_px=dy,
                    dx_arcsec=dx * 184,
                    dy_arcsec=dy * 184,
                    weight=1.0,
                )
            )
    stars.append(
        dict(
            index=len(stars),
            col_px=520.0,
            row_px=410.0,
            flux_dn=200.0,
            peak_dn=40.0,
            area_px=9,
            hip=None,
            name=None,
            v_mag=None,
            dx_px=None,
            dy_px=None,
            dx_arcsec=None,
            dy_arcsec=None,
            weight=None,
        )
    )
    t = np.linspace(0, 1, 60)
    grid = [line(f"{d:+d}°".replace("-", "−"), RA - 40 + 80 * t, d + 0 * t) for d in range(-30, 31, 10)]
    grid += [line(f"{a}°", a + 0 * t, -40 + 80 * t) for a in range(40, 131, 10)]
    up = CAMERA.outline(12) @ ATTITUDE
    field = [(float(np.degrees(np.arctan2(v[1], v[0])) % 360), float(np.degrees(np.arcsin(v[2])))) for v in up]
    rho = np.radians(ROLL)
    from gss.operations.camera_record import record_of

    return dict(
        camera=record_of(CAMERA),
        regions=regions,
        stars=stars,
        predicted=predicted,
        grid=[g for g in grid if g],
        north=(-float(np.sin(rho)), -float(np.cos(rho))),
        field=field,
    )
