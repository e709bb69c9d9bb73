"""calibrations.bad_pixel_table_id: table of the bad pixels of a calibration, for the sensor."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None

FOREIGN_KEY = "fk_calibrations_bad_pixel_table_id_device_tables"


def upgrade() -> None:
    with op.batch_alter_table("calibrations") as batch:
        batch.add_column(sa.Column("bad_pixel_table_id", sa.Integer(), nullable=True))
        batch.create_foreign_key(FOREIGN_KEY, "device_tables", ["bad_pixel_table_id"], ["id"])


def downgrade() -> None:
    with op.batch_alter_table("calibrations") as batch:
        batch.drop_constraint(FOREIGN_KEY, type_="foreignkey")
        batch.drop_column("bad_pixel_table_id")
