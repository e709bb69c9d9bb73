"""Numbers with their unit and origin: ``{value, unit, source}`` or ``{value, unit, chosen: reason}``; with ``sigma`` if
known."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

Text = Annotated[str, Field(min_length=1, max_length=400)]


class Strict(BaseModel):
    """Base of all models of a package: unknown keys, NaN and infinity are errors; instances are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Sourced(Strict):
    """Base of models with exactly one origin: a source, or the reason for a chosen value."""

    source: Text | None = None
    chosen: Text | None = None

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if (self.source is None) == (self.chosen is None):
            raise ValueError("needs either a source or the reason for the chosen value (chosen: …)")
        return self

    @property
    def origin(self) -> str:
        """Return the source, or "chosen: " followed by the reason."""
        return self.source if self.source is not None else f"chosen: {self.chosen}"


class Noted(Strict):
    """Base of models with several numbers. Such a model can state a source, and a reason for the chosen values."""

    source: Text | None = None
    chosen: Text | None = None


class Quantity(Sourced):
    """One number. ``sigma``: its standard deviation in the same unit, if known."""

    value: float
    unit: Annotated[str, Field(max_length=20)]
    sigma: Annotated[float, Field(ge=0, le=1e15)] | None = None


class Coefficients(Sourced):
    """Coefficients of a polynomial, lowest power first."""

    values: Annotated[tuple[float, ...], Field(min_length=1, max_length=8)]
    unit: Annotated[str, Field(max_length=20)]


def _check(unit: str, low: float, high: float, whole: bool) -> AfterValidator:
    def check(quantity: Quantity) -> Quantity:
        if quantity.unit != unit:
            raise ValueError(f"the unit must be {unit}, not {quantity.unit or 'empty'}")
        if not low <= quantity.value <= high:
            raise ValueError(f"must be between {low:g} and {high:g} {unit}, not {quantity.value:g}")
        if whole and quantity.value != int(quantity.value):
            raise ValueError(f"must be a whole number, not {quantity.value:g}")
        return quantity

    return AfterValidator(check)


Pixels = Annotated[Quantity, _check("px", 8, 20_000, True)]
Covered = Annotated[Quantity, _check("px", 0, 1000, True)]
Place = Annotated[Quantity, _check("px", -20_000, 40_000, False)]
Width = Annotated[Quantity, _check("px", 0.05, 50, False)]
Length = Annotated[Quantity, _check("mm", 0.1, 10_000, False)]
Pitch = Annotated[Quantity, _check("mm", 1e-4, 0.2, False)]
Ratio = Annotated[Quantity, _check("1", 0.1, 200, False)]
Share = Annotated[Quantity, _check("1", 1e-4, 1, False)]
Coefficient = Annotated[Quantity, _check("1", -1e6, 1e6, False)]
Angle = Annotated[Quantity, _check("deg", -360, 360, False)]
Opening = Annotated[Quantity, _check("deg", 0, 180, False)]
Decay = Annotated[Quantity, _check("deg", 0.01, 180, False)]
Bits = Annotated[Quantity, _check("bit", 1, 16, True)]
Gain = Annotated[Quantity, _check("e/DN", 1e-3, 1e6, False)]
Level = Annotated[Quantity, _check("DN", 0, 65_535, False)]
Charge = Annotated[Quantity, _check("e", 0, 1e9, False)]
Well = Annotated[Quantity, _check("e", 1, 1e9, False)]
Rate = Annotated[Quantity, _check("e/s", 0, 1e9, False)]
ZeroPoint = Annotated[Quantity, _check("e/s", 1, 1e15, False)]
Magnitude = Annotated[Quantity, _check("mag", -30, 20, False)]
Seconds = Annotated[Quantity, _check("s", 1e-6, 3600, False)]
