"""devices.simulated can be NULL, for devices whose protocol does not report whether they are simulated"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("devices") as batch:
        batch.alter_column("simulated", existing_type=sa.Boolean(), nullable=True)


def downgrade() -> None:
    op.execute("UPDATE devices SET simulated = false WHERE simulated IS NULL")
    with op.batch_alter_table("devices") as batch:
        batch.alter_column("simulated", existing_type=sa.Boolean(), nullable=False)
