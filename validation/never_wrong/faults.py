"""Faults that the never-wrong campaign applies to centroid lists, and the pointings it uses."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.frames import cam_from_icrs
from validation.erlank.sky import random_attitude


class FieldLocation(StrEnum):
    """Location of a field: anywhere, containing a pole, or across right ascension zero."""

    ANYWHERE = "anywhere"
    POLE = "pole"
    ZERO_RA = "zero_ra"


@dataclass(frozen=True)
class Fault:
    """One fault of a centroid list.

    ``false``: number of false stars. ``missing``: share of stars removed. ``off_mag``: added to or subtracted from each
    star's magnitude at random. ``shift_mag``: added to all magnitudes. ``scale``: ratio of the true to the assumed
    focal length. ``mirrored``: left and right are exchanged. ``planets``: number of points brighter than any star
    except Sirius. ``blended``: share of stars with an uncatalogued companion within the spot. ``variable``: share of
    stars that are up to 2 mag fainter than in the catalogue. ``saturated``: bright stars lose their brightness order
    and a pixel of position accuracy. ``another``: the list is from another system's camera. ``place``: location of the
    field. ``share``: share of the trials, because some faults require a search of the whole sky."""

    title: str
    false: int = 0
    missing: float = 0.0
    off_mag: float = 0.0
    shift_mag: float = 0.0
    scale: float = 1.0
    mirrored: bool = False
    planets: int = 0
    blended: float = 0.0
    variable: float = 0.0
    saturated: bool = False
    another: bool = False
    place: FieldLocation = FieldLocation.ANYWHERE
    share: float = 1.0


FAULTS = (
    Fault("no fault"),
    Fault("1 false star", false=1),
    Fault("5 false stars", false=5),
    Fault("10 false stars", false=10),
    Fault("100 false stars", false=100, share=0.1),
    Fault("a third missing, 2 false", false=2, missing=1 / 3),
    Fault("magnitudes ±0.5 each", off_mag=0.5),
    Fault("magnitudes +0.5 all", shift_mag=0.5),
    Fault("focal length +1 %", scale=1.01, share=0.3),
    Fault("focal length −1 %", scale=0.99, share=0.3),
    Fault("mirrored", mirrored=True, share=0.3),
    Fault("mirrored, 10 false stars", false=10, mirrored=True, share=0.3),
    Fault("20 false stars alone", false=20, missing=1.0, share=0.3),
    Fault("4 planets", planets=4),
    Fault("a fifth doubles", blended=0.2),
    Fault("a tenth variable", variable=0.1),
    Fault("bright stars saturated", saturated=True),
    Fault("another camera", another=True, share=0.3),
    Fault("a pole in the field", place=FieldLocation.POLE),
    Fault("across RA = 0", place=FieldLocation.ZERO_RA),
    Fault("magnitudes −0.5 all", shift_mag=-0.5),
    Fault("nothing seen", missing=1.0, share=0.1),
)
"""Append new faults at the end: the index is part of the seed that reproduces a trial."""
PLANET_MAG = (-4.0, 0.5)
BLEND_PX, BLEND_MAG, FADE_MAG = 1.5, 0.75, 2.0
SATURATED_MAG, SATURATED_PX = 2.5, 1.0


def attitude_at(place: FieldLocation, camera: Camera, rng: np.random.Generator) -> Array:
    """Return a (3, 3) cam_from_icrs with random roll whose field contains that location."""
    if place is FieldLocation.ANYWHERE:
        return random_attitude(rng)
    reach_rad = 0.5 * min(camera.fov_rad) * rng.uniform(-1, 1)
    ra_rad, roll_rad = rng.uniform(0, 2 * np.pi, 2)
    if place is FieldLocation.POLE:
        dec_rad = rng.choice((-1.0, 1.0)) * (np.pi / 2 - abs(reach_rad))
        return cam_from_icrs(float(ra_rad), float(dec_rad), float(roll_rad))
    dec_rad = float(np.arcsin(rng.uniform(-0.95, 0.95)))
    return cam_from_icrs(float(reach_rad / np.cos(dec_rad)), dec_rad, float(roll_rad))


def fade(v_mag: Array, fault: Fault, rng: np.random.Generator) -> Array:
    """Return the (n,) magnitudes changed by variability and unresolved companions."""
    n = len(v_mag)
    if fault.variable:
        v_mag = v_mag + np.where(rng.random(n) < fault.variable, rng.uniform(0, FADE_MAG, n), 0.0)
    if fault.blended:
        v_mag = v_mag - np.where(rng.random(n) < fault.blended, rng.uniform(0, BLEND_MAG, n), 0.0)
    return v_mag


def displace(
    pixels: Array, v_mag: Array, seen_mag: float, fault: Fault, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return (n, 2) pixels and (n,) magnitudes changed by companions within the spot and by saturation."""
    n = len(pixels)
    if fault.blended:
        struck = rng.random(n) < fault.blended
        angle, length = rng.uniform(0, 2 * np.pi, n), rng.uniform(0, BLEND_PX, n)
        step = np.stack([np.cos(angle), np.sin(angle)], axis=1) * length[:, None]
        pixels = pixels + np.where(struck[:, None], step, 0.0)
    if fault.saturated:
        top_mag = seen_mag - SATURATED_MAG
        bright = v_mag < top_mag
        pixels = pixels + np.where(bright[:, None], SATURATED_PX * rng.normal(size=(n, 2)), 0.0)
        v_mag = np.where(bright, top_mag - 0.01 * rng.random(n), v_mag)
    return pixels, v_mag


def strangers(fault: Fault, seen_mag: float, camera: Camera, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return (m, 2) pixels and (m,) magnitudes of uncatalogued points: false stars and planets, uniform over the
    detector."""
    edge = (camera.columns - 0.5, camera.rows - 0.5)
    pixels = rng.uniform((-0.5, -0.5), edge, (fault.false, 2))
    v_mag = rng.uniform(seen_mag - 4.0, seen_mag, fault.false)
    if fault.planets:
        pixels = np.vstack([pixels, rng.uniform((-0.5, -0.5), edge, (fault.planets, 2))])
        v_mag = np.concatenate([v_mag, rng.uniform(*PLANET_MAG, fault.planets)])
    return pixels, v_mag
