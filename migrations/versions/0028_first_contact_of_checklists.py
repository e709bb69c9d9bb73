"""First contact of each version of the checklist"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("checklist_versions") as table:
        table.add_column(sa.Column("first_contact_id", sa.Integer(), nullable=False, server_default="0"))
    op.execute(
        "UPDATE checklist_versions SET first_contact_id = coalesce("
        "(SELECT min(contacts.id) FROM contacts WHERE contacts.ended IS NULL OR contacts.ended >= changed), "
        "(SELECT coalesce(max(contacts.id), 0) + 1 FROM contacts))"
    )
    with op.batch_alter_table("checklist_versions") as table:
        table.alter_column("first_contact_id", server_default=None)


def downgrade() -> None:
    with op.batch_alter_table("checklist_versions") as table:
        table.drop_column("first_contact_id")
