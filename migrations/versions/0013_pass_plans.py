"""Pass plans: ordered items for a pass, with their progress"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "pass_plans",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("station_id", sa.Integer(), nullable=False),
        sa.Column("station", sa.String(length=60), nullable=False),
        sa.Column("spacecraft", sa.String(length=80), nullable=False),
        sa.Column("rise", sa.DateTime(), nullable=False),
        sa.Column("set", sa.DateTime(), nullable=False),
        sa.Column("resume", sa.Boolean(), nullable=False),
        sa.Column("items", sa.JSON(), nullable=False),
        sa.Column("confirm", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(length=12), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("author", sa.String(length=60), nullable=False),
        sa.Column("created", sa.DateTime(), nullable=False),
        sa.Column("armed_by", sa.String(length=60), nullable=False),
        sa.Column("armed", sa.DateTime(), nullable=True),
        sa.Column("started", sa.DateTime(), nullable=True),
        sa.Column("finished", sa.DateTime(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_pass_plans")),
    )
    with op.batch_alter_table("pass_plans", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_pass_plans_state"), ["state"], unique=False)


def downgrade() -> None:
    with op.batch_alter_table("pass_plans", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_pass_plans_state"))
    op.drop_table("pass_plans")
