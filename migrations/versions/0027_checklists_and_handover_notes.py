"""Checklists of contacts and hand-over notes"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

import gss.store.models.base

revision = "0027"
down_revision = "0026"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "checklist_versions",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("items", sa.JSON(), nullable=False),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.Column("changed", gss.store.models.base.UtcDateTime(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_checklist_versions")),
    )
    op.create_table(
        "checklist_marks",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("contact_id", sa.Integer(), nullable=False),
        sa.Column("item", sa.String(length=200), nullable=False),
        sa.Column("done", sa.Boolean(), nullable=False),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.Column("at", gss.store.models.base.UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(["contact_id"], ["contacts.id"], name=op.f("fk_checklist_marks_contact_id_contacts")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_checklist_marks")),
    )
    op.create_index(op.f("ix_checklist_marks_contact_id"), "checklist_marks", ["contact_id"])
    op.create_table(
        "handover_notes",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("contact_id", sa.Integer(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.Column("at", gss.store.models.base.UtcDateTime(), nullable=False),
        sa.Column("acknowledged_by", sa.String(length=60), nullable=False),
        sa.Column("acknowledged", gss.store.models.base.UtcDateTime(), nullable=True),
        sa.ForeignKeyConstraint(["contact_id"], ["contacts.id"], name=op.f("fk_handover_notes_contact_id_contacts")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_handover_notes")),
    )
    op.create_index(op.f("ix_handover_notes_contact_id"), "handover_notes", ["contact_id"])


def downgrade() -> None:
    op.drop_table("handover_notes")
    op.drop_table("checklist_marks")
    op.drop_table("checklist_versions")
