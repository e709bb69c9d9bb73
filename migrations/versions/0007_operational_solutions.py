"""Operational ground results: one pinned solution per frame, and the camera that was assumed for each solution

An existing frame gets the first of these solutions that exists: the oldest solution of the configured chain
(GSS_SOLVE_CHAIN) that was computed at reception or from the page; the newest solution of another chain that was not
computed by a campaign; the oldest solution that a campaign computed with the configured chain. Solutions of campaigns
are recognized because they have no stored grid. Reruns of the sensor's own chain are never pinned.
"""

from __future__ import annotations

import os

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

PIN = """
UPDATE solutions SET operational = :yes WHERE id IN (
  SELECT id FROM (
    SELECT id, row_number() OVER (
      PARTITION BY frame_id
      ORDER BY CASE WHEN at_once AND chain = :chain THEN 0 WHEN at_once THEN 1 ELSE 2 END,
               CASE WHEN at_once AND chain <> :chain THEN -id ELSE id END
    ) AS place
    FROM (
      SELECT id, frame_id, chain, CAST(detail AS TEXT) LIKE '%"grid":%' AS at_once
      FROM solutions
      WHERE origin = 'ground' AND replay IS NULL AND CAST(camera AS TEXT) NOT IN ('{}', 'null')
    ) AS candidates
    WHERE at_once OR chain = :chain
  ) AS ordered WHERE place = 1
)
"""


def upgrade() -> None:
    op.add_column("solutions", sa.Column("camera_name", sa.String(length=40), nullable=False, server_default=""))
    op.add_column("solutions", sa.Column("operational", sa.Boolean(), nullable=False, server_default=sa.false()))
    chain = os.environ.get("GSS_SOLVE_CHAIN", "") or "reference"
    op.get_bind().execute(sa.text(PIN), {"yes": True, "chain": chain})
    op.create_index(
        "ix_solutions_operational",
        "solutions",
        ["frame_id"],
        unique=True,
        sqlite_where=sa.text("operational"),
        postgresql_where=sa.text("operational"),
    )


def downgrade() -> None:
    op.drop_index("ix_solutions_operational", "solutions")
    with op.batch_alter_table("solutions", schema=None) as batch_op:
        batch_op.drop_column("operational")
        batch_op.drop_column("camera_name")
