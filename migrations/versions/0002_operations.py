"""Operations: alarms, authority, stacks, tables, captures"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "alarms",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("packet", sa.String(length=40), nullable=False),
        sa.Column("field", sa.String(length=60), nullable=False),
        sa.Column("state", sa.String(length=10), nullable=False),
        sa.Column("worst", sa.String(length=10), nullable=False),
        sa.Column("value", sa.Double(), nullable=True),
        sa.Column("limit_text", sa.String(length=120), nullable=False),
        sa.Column("limit_set", sa.String(length=30), nullable=False),
        sa.Column("raised", sa.DateTime(), nullable=False),
        sa.Column("cleared", sa.DateTime(), nullable=True),
        sa.Column("acknowledged", sa.DateTime(), nullable=True),
        sa.Column("acknowledged_by", sa.String(length=60), nullable=False),
        sa.Column("shelved_until", sa.DateTime(), nullable=True),
        sa.Column("shelved_by", sa.String(length=60), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("closed", sa.DateTime(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_alarms")),
    )
    with op.batch_alter_table("alarms", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_alarms_closed"), ["closed"], unique=False)
        batch_op.create_index(batch_op.f("ix_alarms_field"), ["field"], unique=False)
        batch_op.create_index(batch_op.f("ix_alarms_raised"), ["raised"], unique=False)

    op.create_table(
        "authorities",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("holder", sa.String(length=60), nullable=False),
        sa.Column("taken", sa.DateTime(), nullable=False),
        sa.Column("ended", sa.DateTime(), nullable=True),
        sa.Column("ended_by", sa.String(length=60), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_authorities")),
    )
    with op.batch_alter_table("authorities", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_authorities_ended"), ["ended"], unique=False)

    op.create_table(
        "choices",
        sa.Column("name", sa.String(length=60), nullable=False),
        sa.Column("value", sa.JSON(), nullable=False),
        sa.Column("changed", sa.DateTime(), nullable=False),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_choices")),
    )
    op.create_table(
        "device_tables",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("profile", sa.String(length=40), nullable=False),
        sa.Column("format_version", sa.Integer(), nullable=False),
        sa.Column("size", sa.Integer(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("created", sa.DateTime(), nullable=False),
        sa.Column("author", sa.String(length=60), nullable=False),
        sa.Column("content", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_device_tables")),
    )
    with op.batch_alter_table("device_tables", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_device_tables_sha256"), ["sha256"], unique=False)

    op.create_table(
        "stacks",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("steps", sa.JSON(), nullable=False),
        sa.Column("author", sa.String(length=60), nullable=False),
        sa.Column("changed", sa.DateTime(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_stacks")),
        sa.UniqueConstraint("name", name=op.f("uq_stacks_name")),
    )
    op.create_table(
        "stack_runs",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("stack_id", sa.Integer(), nullable=True),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("steps", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(length=12), nullable=False),
        sa.Column("step", sa.Integer(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.Column("started", sa.DateTime(), nullable=False),
        sa.Column("finished", sa.DateTime(), nullable=True),
        sa.ForeignKeyConstraint(
            ["stack_id"], ["stacks.id"], name=op.f("fk_stack_runs_stack_id_stacks"), ondelete="SET NULL"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_stack_runs")),
    )
    with op.batch_alter_table("stack_runs", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_stack_runs_state"), ["state"], unique=False)

    with op.batch_alter_table("commands", schema=None) as batch_op:
        batch_op.add_column(sa.Column("run_id", sa.Integer(), nullable=True))
        batch_op.create_index(batch_op.f("ix_commands_run_id"), ["run_id"], unique=False)
        batch_op.create_foreign_key(batch_op.f("fk_commands_run_id_stack_runs"), "stack_runs", ["run_id"], ["id"])

    with op.batch_alter_table("contacts", schema=None) as batch_op:
        batch_op.add_column(sa.Column("captures", sa.JSON(), nullable=False, server_default="[]"))
        batch_op.add_column(sa.Column("note", sa.Text(), nullable=False, server_default=""))

    with op.batch_alter_table("transfers", schema=None) as batch_op:
        batch_op.add_column(sa.Column("table_id", sa.Integer(), nullable=True))
        batch_op.add_column(sa.Column("options", sa.JSON(), nullable=False, server_default="{}"))
        batch_op.create_foreign_key(
            batch_op.f("fk_transfers_table_id_device_tables"), "device_tables", ["table_id"], ["id"]
        )


def downgrade() -> None:
    with op.batch_alter_table("transfers", schema=None) as batch_op:
        batch_op.drop_constraint(batch_op.f("fk_transfers_table_id_device_tables"), type_="foreignkey")
        batch_op.drop_column("options")
        batch_op.drop_column("table_id")

    with op.batch_alter_table("contacts", schema=None) as batch_op:
        batch_op.drop_column("note")
        batch_op.drop_column("captures")

    with op.batch_alter_table("commands", schema=None) as batch_op:
        batch_op.drop_constraint(batch_op.f("fk_commands_run_id_stack_runs"), type_="foreignkey")
        batch_op.drop_index(batch_op.f("ix_commands_run_id"))
        batch_op.drop_column("run_id")

    with op.batch_alter_table("stack_runs", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_stack_runs_state"))

    op.drop_table("stack_runs")
    op.drop_table("stacks")
    with op.batch_alter_table("device_tables", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_device_tables_sha256"))

    op.drop_table("device_tables")
    op.drop_table("choices")
    with op.batch_alter_table("authorities", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_authorities_ended"))

    op.drop_table("authorities")
    with op.batch_alter_table("alarms", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_alarms_raised"))
        batch_op.drop_index(batch_op.f("ix_alarms_field"))
        batch_op.drop_index(batch_op.f("ix_alarms_closed"))

    op.drop_table("alarms")
