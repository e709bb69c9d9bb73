"""Telemetry rollups: extremes of every ten seconds, one row per field and hour"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "telemetry_rollups",
        sa.Column("packet", sa.String(length=40), nullable=False),
        sa.Column("field", sa.String(length=60), nullable=False),
        sa.Column("hour", sa.Integer(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("packet", "field", "hour", name=op.f("pk_telemetry_rollups")),
    )


def downgrade() -> None:
    op.drop_table("telemetry_rollups")
