"""What the OreSat star tracker last reported: its clock, its images, and the parts of its latest attitude."""

from __future__ import annotations

from dataclasses import dataclass, field

TAKING_IMAGES = ("star_track", "capture")
STEADY_S = 10.0
"""While the sensor takes images, a download begins only after no new image has appeared for this time, because with the
sensor's default settings a download takes longer than the pause between two images."""
REPLACES_IMAGES = "waits until the sensor stops taking images, because each new image replaces the previous one"


@dataclass
class SensorClock:
    """Estimate of the sensor's clock. ``ahead_s``: sensor time minus the ground's ``now_s``, None while unknown."""

    now_s: float = 0.0
    ahead_s: float | None = None

    def time_s(self) -> float | None:
        """Return the sensor's current time in seconds; None while unknown."""
        return None if self.ahead_s is None else self.now_s + self.ahead_s


@dataclass
class SensorImages:
    """What the sensor last reported about its images. ``number``: number of the latest image, unchanged since
    ``since_s``."""

    status: str = ""
    number: int = 0
    since_s: float = 0.0

    def note_number(self, number: int, now_s: float) -> None:
        """Update the number of the latest image."""
        if number != self.number:
            self.number, self.since_s = number, now_s

    def wait_reason(self, now_s: float) -> str:
        """Return why no image can be downloaded now, "" if one can."""
        replaces = self.status in TAKING_IMAGES and now_s - self.since_s < STEADY_S
        return REPLACES_IMAGES if replaces else ""


@dataclass
class SolveParts:
    """Received process data objects of one attitude, by number."""

    parts: dict[int, bytes] = field(default_factory=dict)

    def add(self, number: int, data: bytes) -> None:
        """Add an object. An object out of order belongs to another attitude and discards the previous ones."""
        follows = number - 1 in self.parts and number not in self.parts
        self.parts = {number: data} if number == 3 else self.parts | {number: data} if follows else {}

    def take_joined(self, numbers: tuple[int, ...]) -> bytes | None:
        """Remove and return the objects of these numbers, joined; None if an object is missing."""
        if any(n not in self.parts for n in numbers):
            return None
        data = b"".join(self.parts[n] for n in numbers)
        self.parts = {}
        return data
