"""Changed constants of the chain of a solution"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("solutions", sa.Column("options", sa.Text(), server_default="", nullable=False))


def downgrade() -> None:
    op.drop_column("solutions", "options")
