"""bank_history.told is renamed to reported: time of the device's last report"""

from __future__ import annotations

from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("bank_history") as batch:
        batch.alter_column("told", new_column_name="reported")


def downgrade() -> None:
    with op.batch_alter_table("bank_history") as batch:
        batch.alter_column("reported", new_column_name="told")
