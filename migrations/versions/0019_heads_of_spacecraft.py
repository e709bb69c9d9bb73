"""Spacecraft with several heads, fused attitudes, and the comparison history of each pair of heads"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "spacecraft",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=40), nullable=False),
        sa.Column("heads", sa.JSON(), nullable=False),
        sa.Column("source", sa.String(length=10), nullable=False),
        sa.Column("tolerance_s", sa.Double(), nullable=False),
        sa.Column("stale_s", sa.Double(), nullable=False),
        sa.Column("largest_rate_rad_s", sa.Double(), nullable=True),
        sa.Column("misalignment_limit_rad", sa.Double(), nullable=True),
        sa.Column("drift_limit_rad_s", sa.Double(), nullable=True),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.Column("changed", sa.DateTime(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_spacecraft")),
        sa.UniqueConstraint("name", name=op.f("uq_spacecraft_name")),
    )
    op.create_table(
        "fused_attitudes",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("spacecraft_id", sa.Integer(), nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.Column("units", sa.JSON(), nullable=False),
        sa.Column("quaternion", sa.JSON(), nullable=False),
        sa.Column("covariance", sa.JSON(), nullable=False),
        sa.Column("chi2", sa.Double(), nullable=True),
        sa.Column("freedom", sa.Integer(), nullable=True),
        sa.Column("probability", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(
            ["spacecraft_id"],
            ["spacecraft.id"],
            name=op.f("fk_fused_attitudes_spacecraft_id_spacecraft"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_fused_attitudes")),
    )
    with op.batch_alter_table("fused_attitudes", schema=None) as batch_op:
        batch_op.create_index("ix_fused_attitudes_spacecraft_at", ["spacecraft_id", "at"], unique=False)

    op.create_table(
        "head_pairs",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("spacecraft_id", sa.Integer(), nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.Column("reference", sa.String(length=24), nullable=False),
        sa.Column("unit", sa.String(length=24), nullable=False),
        sa.Column("angle_rad", sa.Double(), nullable=False),
        sa.Column("angle_sigma_rad", sa.Double(), nullable=False),
        sa.Column("boresight_rad", sa.Double(), nullable=False),
        sa.Column("boresight_sigma_rad", sa.Double(), nullable=False),
        sa.Column("chi2", sa.Double(), nullable=False),
        sa.Column("state", sa.JSON(), nullable=False),
        sa.Column("covariance", sa.JSON(), nullable=False),
        sa.Column("lasting", sa.JSON(), nullable=False),
        sa.Column("began", sa.DateTime(), nullable=False),
        sa.Column("samples", sa.Integer(), nullable=False),
        sa.Column("restarts", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["spacecraft_id"],
            ["spacecraft.id"],
            name=op.f("fk_head_pairs_spacecraft_id_spacecraft"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_head_pairs")),
    )
    with op.batch_alter_table("head_pairs", schema=None) as batch_op:
        batch_op.create_index("ix_head_pairs_spacecraft_at", ["spacecraft_id", "at"], unique=False)


def downgrade() -> None:
    with op.batch_alter_table("head_pairs", schema=None) as batch_op:
        batch_op.drop_index("ix_head_pairs_spacecraft_at")

    op.drop_table("head_pairs")
    with op.batch_alter_table("fused_attitudes", schema=None) as batch_op:
        batch_op.drop_index("ix_fused_attitudes_spacecraft_at")

    op.drop_table("fused_attitudes")
    op.drop_table("spacecraft")
