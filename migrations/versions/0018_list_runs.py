"""Uploaded lists of measured stars"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

import gss.store.models.base

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "list_runs",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=120), nullable=False),
        sa.Column("created", gss.store.models.base.UtcDateTime(), nullable=False),
        sa.Column("author", sa.String(length=60), nullable=False),
        sa.Column("tool", sa.String(length=40), nullable=False),
        sa.Column("camera", sa.String(length=40), nullable=False),
        sa.Column("no_distortion", sa.Boolean(), nullable=False),
        sa.Column("sigma_px", sa.Double(), nullable=False),
        sa.Column("epoch_jyear", sa.Double(), nullable=False),
        sa.Column("lists", sa.Integer(), nullable=False),
        sa.Column("size", sa.Integer(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("solved", sa.Integer(), nullable=True),
        sa.Column("results_sha256", sa.String(length=64), nullable=False),
        sa.Column("results_size", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_list_runs")),
    )
    op.create_index(op.f("ix_list_runs_results_sha256"), "list_runs", ["results_sha256"])
    op.create_index(op.f("ix_list_runs_sha256"), "list_runs", ["sha256"])


def downgrade() -> None:
    op.drop_index(op.f("ix_list_runs_sha256"), table_name="list_runs")
    op.drop_index(op.f("ix_list_runs_results_sha256"), table_name="list_runs")
    op.drop_table("list_runs")
