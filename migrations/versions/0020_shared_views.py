"""Shared views of the console"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

import gss.store.models.base

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "shared_views",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("path", sa.Text(), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("owner", sa.String(length=60), nullable=False),
        sa.Column("open", sa.Boolean(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.Column("changed", gss.store.models.base.UtcDateTime(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_shared_views")),
        sa.UniqueConstraint("name", name=op.f("uq_shared_views_name")),
    )
    op.create_table(
        "shared_view_versions",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("view_id", sa.Integer(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("path", sa.Text(), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.Column("changed", gss.store.models.base.UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["view_id"],
            ["shared_views.id"],
            name=op.f("fk_shared_view_versions_view_id_shared_views"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_shared_view_versions")),
        sa.UniqueConstraint("view_id", "version", name=op.f("uq_shared_view_versions_view_id")),
    )


def downgrade() -> None:
    op.drop_table("shared_view_versions")
    op.drop_table("shared_views")
