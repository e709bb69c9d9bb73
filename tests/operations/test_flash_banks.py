"""Banks of catalogues and tables, identified by kind and bank."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from gss.domain.errors import BadInput, Conflict
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.transfers.flash_banks import CATALOGUES, TABLES, FlashBanks

SHA256 = bytes(range(32))


def flash(hello: Any = "a device") -> FlashBanks:
    """Return the banks of a device that has identified itself."""
    return FlashBanks(SimpleNamespace(hello=hello, reason="silence", roles=default_roles(load_dictionary())))  # type: ignore[arg-type]


def test_reports_of_catalogues_and_tables_are_separated_by_kind() -> None:
    """Reports of catalogues and of each kind of table are separate. A newer report replaces an older one."""
    banks = flash()
    banks.take({"bank": "A", "state": "empty", "active": False, "sha256": bytes(32)})
    banks.take({"table": "calibration", "bank": "B", "state": "empty", "active": False, "sha256": bytes(32)})
    banks.take({"table": "parameters", "bank": "B", "state": "committed", "active": True, "sha256": SHA256})
    held = banks.take({"bank": "A", "state": "committed", "active": True, "sha256": SHA256})
    assert banks.of(CATALOGUES) == [held]
    assert (held.kind, held.sha256, held.holds_data) == ("catalogue", SHA256.hex(), True)
    assert [(r.kind, r.bank, r.sha256) for r in banks.of(TABLES)] == [
        ("calibration", "B", ""),
        ("parameters", "B", SHA256.hex()),
    ]
    banks.forget()
    assert banks.of(CATALOGUES) == banks.of(TABLES) == []


def test_an_upload_goes_to_an_inactive_bank_of_its_kind() -> None:
    """An upload to an active bank of the same kind or to an unknown bank, or without an identified device, is rejected."""
    banks = flash()
    banks.take({"table": "parameters", "bank": "B", "state": "committed", "active": True, "sha256": SHA256})
    assert banks.target("calibration", "B")[0] == TABLES.number(default_roles(load_dictionary()).operations, "B")
    with pytest.raises(Conflict, match="parameters bank B is active"):
        banks.target("parameters", "B")
    with pytest.raises(BadInput, match="no such choice"):
        banks.target("catalogue", "Z")
    with pytest.raises(Conflict, match="no device has answered"):
        flash(None).target("catalogue", "A")
