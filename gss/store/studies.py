"""Calibrations and analyses, which are never deleted."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Analysis, Calibration


def add_calibration(session: Session, row: Calibration) -> Calibration:
    """Store a calibration and assign its id."""
    session.add(row)
    session.flush()
    return row


def calibration(session: Session, calibration_id: int) -> Calibration:
    """Return the calibration with that id. Raises NotFound if it does not exist."""
    row = session.get(Calibration, calibration_id)
    if row is None:
        raise NotFound("no such calibration", got=str(calibration_id))
    return row


def calibrations(session: Session, limit: int, profile: str = "") -> list[Calibration]:
    """Return the latest calibrations, newest first. ``profile``: camera to include; "": all."""
    query = select(Calibration).where(Calibration.profile == profile) if profile else select(Calibration)
    return list(session.scalars(query.order_by(Calibration.id.desc()).limit(limit)))


def add_analysis(session: Session, row: Analysis) -> Analysis:
    """Store an analysis and assign its id."""
    session.add(row)
    session.flush()
    return row


def analysis(session: Session, analysis_id: int) -> Analysis:
    """Return the analysis with that id. Raises NotFound if it does not exist."""
    row = session.get(Analysis, analysis_id)
    if row is None:
        raise NotFound("no such analysis", got=str(analysis_id))
    return row


def analyses(session: Session, limit: int, kind: str = "") -> list[Analysis]:
    """Return the latest analyses, newest first. ``kind``: kind to include; "": all."""
    query = select(Analysis).where(Analysis.kind == kind) if kind else select(Analysis)
    return list(session.scalars(query.order_by(Analysis.id.desc()).limit(limit)))
