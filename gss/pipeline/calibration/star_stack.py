"""Arrays of the stars of all frames, and separate fits of the frames' attitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.pipeline.attitude import svd
from gss.pipeline.calibration.sightings import FrameStars


@dataclass(frozen=True)
class StarStack:
    """All stars of all frames, frame after frame. ``frame``: (n,) index; ``first``: (f,) offset of each frame."""

    pixels: Array
    sigma_px: Array
    icrs: Array
    frame: NDArray[np.intp]
    first: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def frames(self) -> int:
        """Return the number of frames."""
        return len(self.first)

    def of_frames(self, keep: NDArray[np.bool_]) -> StarStack:
        """Return the stars of the frames selected by an (f,) mask."""
        stars = keep[self.frame]
        counts = np.bincount(self.frame, minlength=self.frames)[keep]
        frame = np.repeat(np.arange(len(counts)), counts)
        first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.intp)
        return StarStack(self.pixels[stars], self.sigma_px[stars], self.icrs[stars], frame, first)


def stack(frames: Sequence[FrameStars]) -> StarStack:
    """Concatenate frames, each of which must have at least one star."""
    counts = np.array([len(f) for f in frames])
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.intp)
    return StarStack(
        np.concatenate([f.pixels for f in frames]),
        np.concatenate([f.sigma_px for f in frames]),
        np.concatenate([f.icrs for f in frames]),
        np.repeat(np.arange(len(frames)), counts),
        first,
    )


def attitudes_of(stars: StarStack, camera: Camera) -> Array:
    """Return (f, 3, 3) cam_from_icrs, fitted to each frame separately with a fixed camera."""
    cam = camera.unproject(stars.pixels)
    ends = np.append(stars.first[1:], len(stars))
    attitudes = []
    for low, high in zip(stars.first, ends, strict=True):
        good = np.isfinite(cam[low:high]).all(axis=1)
        attitudes.append(svd(cam[low:high][good], stars.icrs[low:high][good]))
    return np.stack(attitudes)
