"""docs/licences.md names every locked dependency, and its licence permits use in GSS."""

from __future__ import annotations

import re
from pathlib import Path

from tools.licences import PAGE, licence_of, locked, page_packages, rows_of, sbom

REFUSED = re.compile(r"(?<!L)(?:A?GPL)|SSPL|BUSL|Commons Clause|not stated|^UNKNOWN$")


def test_every_locked_package_is_on_the_page_with_its_own_licence(root: Path) -> None:
    """The page has a row with version and licence for each locked package.

    Regenerate with: python -m tools.licences.
    """
    rows, text = rows_of(PAGE.read_text()), PAGE.read_text()
    for name, version, _ in locked():
        assert f"| {name} | {version} | " in text, name
        assert licence_of(name) in (None, rows[name]), name
    for name, version, licence in page_packages():
        assert f"| {name} | {version} | {licence} |" in text, name


def test_no_dependency_has_terms_that_would_bind_gss() -> None:
    """Licences are permissive, or weak copyleft that permits use as a library (LGPL, MPL)."""
    refused = {name: licence for name, licence in rows_of(PAGE.read_text()).items() if REFUSED.search(licence)}
    assert not refused


def test_the_bill_of_materials_has_each_package_with_its_hashes() -> None:
    """The CycloneDX bill of materials lists each package of the lock files with its hashes."""
    bill = sbom()
    python_packages = [c for c in bill["components"] if c["purl"].startswith("pkg:pypi/")]
    assert len(python_packages) == len(locked()) > 50
    assert all(c["hashes"] for c in python_packages)
