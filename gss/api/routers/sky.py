"""Sky data for charts, constellation lines, camera profiles and chains."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from fastapi import Path, Query

from gss.api.api_router import api_router
from gss.api.deps import App, QueryTime
from gss.api.schemas.sky import BodyOut, ChainOptionOut, ChartStarOut, FigureOut, ProfileOut, SkyOut
from gss.catalogue_tools.onboard import FORMATS
from gss.catalogue_tools.sources.constellations import FAINTEST_JOINED_MAG, figures
from gss.domain.angles import ra_dec_from_unit
from gss.operations.frames.place import EARTH_EXCLUSION_RAD
from gss.operations.frames.sky import bodies
from gss.operations.frames.solve import CHAINS, options_of

router = api_router("sky")


@router.get("/sky")
def read_sky(app: App, mag: Annotated[float, Query(ge=-2, le=7)] = 4.5, at: QueryTime | None = None) -> SkyOut:
    """Stars to a magnitude limit, Sun, Moon and, if the camera's position is known, the Earth; now or at a given
    time."""
    now = at or app.base.clock.now()
    bright = app.base.stars.brighter_than(mag)
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(bright.icrs))
    stars = [
        ChartStarOut(hip=int(h), name=bright.name_of(int(h)), ra_deg=float(a), dec_deg=float(d), v_mag=float(v))
        for h, a, d, v in zip(bright.hip, ra, dec, bright.v_mag, strict=True)
    ]
    bodies_out = []
    for body in bodies(now):
        a, d = ra_dec_from_unit(body.icrs)
        bodies_out.append(
            BodyOut(
                name=body.name,
                ra_deg=math.degrees(float(a)),
                dec_deg=math.degrees(float(d)),
                exclusion_deg=math.degrees(body.exclusion_rad),
            )
        )
    observer = app.passes.place.at(now)
    if observer is not None:
        below_ra, below_dec = (math.degrees(float(v)) for v in ra_dec_from_unit(observer.earth_icrs))
        exclusion, radius = math.degrees(EARTH_EXCLUSION_RAD), math.degrees(observer.earth_radius_rad)
        bodies_out.append(
            BodyOut(name="Earth", ra_deg=below_ra, dec_deg=below_dec, exclusion_deg=exclusion, radius_deg=radius)
        )
    return SkyOut(utc=now, place="" if observer is None else observer.source, stars=stars, bodies=bodies_out)


@router.get("/sky/figures")
def read_figures(app: App) -> list[FigureOut]:
    """Constellation lines between stars of the star table."""
    bright = app.base.stars.brighter_than(FAINTEST_JOINED_MAG)
    drawn_figures = figures(bright)
    ra, dec = (np.degrees(a).round(3).tolist() for a in ra_dec_from_unit(bright.icrs))
    position = {int(hip): (a, d) for hip, a, d in zip(bright.hip, ra, dec, strict=True)}
    return [FigureOut(name=f.name, lines=[[position[hip] for hip in line] for line in f.lines]) for f in drawn_figures]


@router.get("/profiles")
def list_profiles(app: App) -> list[ProfileOut]:
    """Camera profiles."""
    return [
        ProfileOut(
            name=p.name,
            title=p.title,
            columns=p.camera.columns,
            rows=p.camera.rows,
            fov_deg=(math.degrees(p.camera.fov_rad[0]), math.degrees(p.camera.fov_rad[1])),
            focal_mm=p.focal_mm,
            faint_mag=p.sensor.faint_limit_mag,
            bits=p.sensor.bits,
            formats=[*p.formats, *sorted(set(FORMATS) - set(p.formats))],
            unit=p.name == app.base.settings.unit_instrument,
        )
        for p in app.base.instruments.cameras().values()
    ]


@router.get("/chains")
def list_chains(app: App) -> list[str]:
    """Names of the chains that can solve a frame, the reference chain first."""
    return list(CHAINS)


@router.get("/chains/{chain}/options")
def chain_options(
    app: App, chain: Annotated[str, Path(max_length=30)], profile: Annotated[str, Query(max_length=40)]
) -> list[ChainOptionOut]:
    """Constants of a chain that a rerun can change, with their values for a camera profile and their sources."""
    return [ChainOptionOut.model_validate(o) for o in options_of(chain, app.studies.calibrations.book.profile(profile))]
