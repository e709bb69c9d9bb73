"""Layouts of the Rerun viewer, one per use."""

from __future__ import annotations

from enum import StrEnum
from typing import Any


class Use(StrEnum):
    """Purpose of a recording."""

    FRAME = "frame"
    SEQUENCE = "sequence"
    CONTACT = "contact"
    CAMPAIGN = "campaign"
    LIVE = "live"


def blueprint(use: Use) -> Any:
    """Return the viewer layout with sky, picture, plots and log for a use. Contacts use the UTC timeline, all other
    recordings the frame timeline. A live recording follows the latest data."""
    import rerun.blueprint as rrb  # imported here because the import takes 0.5 s and 100 MB

    sky = rrb.Spatial3DView(origin="/sky", name="Sky", line_grid=rrb.LineGrid3D(visible=False))
    picture = rrb.Spatial2DView(origin="/camera/image", name="Frame", contents=["/camera/image/**"])
    # On the frame page the plot is small and a legend would cover the lines. There, the cursor shows the names.
    legend = rrb.PlotLegend(visible=use is not Use.FRAME)
    attitude = rrb.TimeSeriesView(origin="/attitude", name="Attitude, arcseconds", plot_legend=legend)
    stars = rrb.TimeSeriesView(origin="/stars", name="Stars")
    telemetry = rrb.TimeSeriesView(origin="/telemetry", name="Telemetry")
    states = rrb.StateTimelineView(origin="/states", name="States")
    log = rrb.TextLogView(origin="/log", name="Log")
    time = rrb.TimePanel(
        state="collapsed",
        timeline="utc" if use is Use.CONTACT else "frame",
        play_state="following" if use is Use.LIVE else "paused",
    )
    if use is Use.FRAME:
        side = rrb.Vertical(picture, attitude, rrb.Tabs(log, states), row_shares=[2, 1, 1])
        body: Any = rrb.Horizontal(sky, side, column_shares=[3, 2])
    elif use is Use.CAMPAIGN:
        plots = rrb.Vertical(attitude, stars, row_shares=[1, 1])
        body = rrb.Horizontal(rrb.Vertical(plots, log, row_shares=[3, 1]), rrb.Vertical(picture, sky))
    elif use is Use.CONTACT:
        top_row = rrb.Horizontal(picture, sky, log, column_shares=[3, 3, 2])
        body = rrb.Vertical(top_row, states, rrb.Horizontal(telemetry, attitude, stars), row_shares=[6, 2, 4])
    else:
        side = rrb.Vertical(picture, attitude, rrb.Tabs(states, log, telemetry, stars), row_shares=[2, 1, 1])
        body = rrb.Horizontal(sky, side, column_shares=[3, 2])
    return rrb.Blueprint(
        body,
        time,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )
