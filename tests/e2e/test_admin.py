"""The Admin page, and controls that other roles may not use."""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from typing import Any

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(180)]
PASSWORD = "rigel above the roof"
SEND_REQUEST = """async ([method, path, body]) => {
    const who = await (await fetch('/api/session')).json();
    const answer = await fetch('/api' + path, { method, headers: { 'X-GSS': who.csrf, 'Content-Type': 'application/json' },
        body: body === null ? null : JSON.stringify(body) });
    return [answer.status, await answer.text()];
}"""
# For each role: a page, a control that the role may not use there, the permitted roles, and the request of the control.
FORBIDDEN = [
    (
        "viewer",
        "/live",
        "cmd-TAKE_IMAGE",
        "operator's or engineer's",
        ("POST", "/commands", {"name": "TAKE_IMAGE", "arguments": {}}),
    ),
    ("viewer", "/frames", "import", "engineer's", ("PUT", "/frames/1/favourite", {"favourite": True})),
    ("viewer", "/contacts", "link-close", "operator's", ("POST", "/link/close", None)),
    ("engineer", "/catalogues/new", "build", "catalogue manager's", ("POST", "/catalogues", {"name": "x"})),
    (
        "engineer",
        "/live",
        "cmd-CALCULATE_ATTITUDE",
        "operator's",
        ("POST", "/commands", {"name": "CALCULATE_ATTITUDE", "arguments": {}}),
    ),
    (
        "catalogue manager",
        "/live",
        "cmd-TAKE_IMAGE",
        "operator's or engineer's",
        ("POST", "/commands", {"name": "TAKE_IMAGE", "arguments": {}}),
    ),
    (
        "catalogue manager",
        "/campaigns",
        "reprocess-start",
        "engineer's",
        ("POST", "/campaigns/reprocess", {"chain": "reference"}),
    ),
    ("operator", "/frames", "import", "engineer's", ("POST", "/users", {"name": "x", "role": "admin"})),
]


@pytest.fixture
def role(request: pytest.FixtureRequest) -> str:
    """Role of the user of the page."""
    return getattr(request, "param", "admin")


@pytest.fixture
def cookie(role: str, served: Any, signed_in: Callable[..., dict[str, str]]) -> str:
    """Key of the session of a user with that role."""
    return signed_in(served.folder, role)["Cookie"].split("=", 1)[1]


def make_user(page, name, role):
    """Add a user on the page and return the one-time link."""
    page.goto("/admin?show=people")
    page.get_by_test_id("new-user-name").fill(name)
    page.get_by_test_id(f"new-user-{role}").check()
    page.get_by_test_id("new-user-go").click()
    expect(page.get_by_test_id("user-link")).to_contain_text(f"Link for {name}")
    link = page.get_by_test_id("one-time").input_value()
    page.get_by_test_id("one-time-close").click()
    expect(page.get_by_test_id("user-link")).to_have_count(0)
    return link


@pytest.fixture
def as_user(page, browser, address):
    """Create a user with a role, open the link in a separate browser, and return its page."""
    contexts = []

    def open_link(name, role, start="/live"):
        link = open_link.links[name] = make_user(page, name, role)
        context = browser.new_context(base_url=address, viewport={"width": 1280, "height": 800})
        contexts.append(context)
        user_page = context.new_page()
        user_page.goto(link)
        user_page.get_by_test_id("new-password").fill(PASSWORD)
        user_page.get_by_test_id("new-password-again").fill(PASSWORD)
        user_page.keyboard.press("Enter")
        expect(user_page.get_by_test_id("user-cell")).to_contain_text(name)
        user_page.goto(start)
        return user_page

    open_link.links = {}
    yield open_link
    for context in contexts:
        context.close()


def test_a_new_user_signs_in_with_a_one_time_link(page, as_user, picture):
    """A new user chooses a password with a link and is listed with the session. The link works once."""
    user_page = as_user("vera", "viewer")
    expect(user_page.get_by_test_id("nav-admin")).to_have_count(0)
    user_page.goto("/admin")
    expect(user_page.get_by_test_id("admin-refused")).to_contain_text("needs the admin's role, you are a viewer")
    page.reload()
    expect(page.locator("[data-testid=user-row][data-user=vera]")).to_contain_text("active")
    expect(page.locator("[data-testid=session-row][data-user=vera]")).to_have_count(1)
    expect(page.get_by_test_id("people-audit")).to_contain_text("vera")
    picture("admin-people")
    user_page.goto("about:blank")
    user_page.goto(as_user.links["vera"])
    expect(user_page.get_by_test_id("link-over")).to_contain_text("invalid, expired or already used")


@pytest.mark.parametrize("role", ["viewer", "engineer", "catalogue manager", "operator"], indirect=True)
def test_forbidden_controls_are_dashed_with_a_reason(page: Page, role: str) -> None:
    """A forbidden control can be reached by keyboard, states the reason and does nothing. The server rejects the
    request.
    """
    for _, path, control, permitted_roles, request in [row for row in FORBIDDEN if row[0] == role]:
        page.goto(path)
        element = page.get_by_test_id(control)
        expect(element).to_have_attribute(
            "data-disabled-reason", re.compile(re.escape(f"needs the {permitted_roles} role, you are"))
        )
        element.focus()
        expect(element).to_be_focused()
        expect(page.locator("#disabled-reason")).to_contain_text(permitted_roles)
        assert element.evaluate("e => getComputedStyle(e).borderTopStyle") == "dashed"
        page.keyboard.press("Enter")
        status, text = page.evaluate(SEND_REQUEST, list(request))
        assert status == 403, (path, status, text)
        assert "role" in text
    expect(page.get_by_test_id("toasts")).to_have_text("")


def test_an_operator_can_use_the_controls_of_the_page(as_user):
    """For an operator no control of the page is disabled, and a command is sent."""
    user_page = as_user("olga", "operator")
    expect(user_page.get_by_test_id("link-state")).to_contain_text("up")
    expect(user_page.get_by_test_id("cmd-TAKE_IMAGE")).not_to_have_attribute("data-disabled-reason", re.compile(".+"))
    user_page.get_by_test_id("cmd-TAKE_IMAGE").click()
    expect(user_page.get_by_test_id("cmd-TAKE_IMAGE")).to_have_attribute("data-result", "completed")
    user_page.get_by_test_id("authority-open").click()
    user_page.get_by_test_id("authority-release").click()


def test_role_changes_and_disabling_apply_at_once(page, as_user):
    """A changed role applies at once. A disabled user sees the sign-in form within seconds."""
    user_page = as_user("ines", "catalogue manager", "/frames")
    row = page.locator("[data-testid=user-row][data-user=ines]")
    with page.expect_response(lambda r: "/api/users/" in r.url and r.request.method == "PUT") as changed:
        row.get_by_test_id("user-role").select_option("engineer")
    assert changed.value.ok
    user_page.reload()
    expect(user_page.get_by_test_id("import")).not_to_have_attribute("data-disabled-reason", re.compile(".+"))
    row.get_by_test_id("user-off").click()
    expect(row).to_contain_text("sessions end immediately")
    row.get_by_test_id("user-off-now").click()
    expect(row).to_contain_text("deactivated")
    expect(user_page.get_by_test_id("session-ended")).to_be_visible()


def test_a_token_is_shown_once_works_and_can_be_revoked(page, browser, address, picture):
    """The key is shown once. A client may read with the token, may not close the link, and is rejected after
    revocation.
    """
    page.goto("/admin?show=tokens")
    page.get_by_test_id("new-token-name").fill("watchdog")
    page.get_by_test_id("new-token-days").fill("30")
    page.get_by_test_id("new-token-go").click()
    expect(page.get_by_test_id("token-key")).to_be_visible()
    key = page.get_by_test_id("one-time").input_value()
    assert key.startswith("gss_")
    picture("admin-tokens")
    program = browser.new_context(base_url=address, extra_http_headers={"Authorization": f"Bearer {key}"})
    assert program.request.get("/api/link").status == 200
    assert program.request.post("/api/link/close").status == 403
    page.get_by_test_id("one-time-close").click()
    assert key not in page.content()
    row = page.locator("[data-testid=token-row][data-token=watchdog]")
    row.get_by_test_id("token-revoke").click()
    expect(row).to_contain_text("revoked")
    assert program.request.get("/api/link").status == 401
    program.close()


def test_the_audit_log_is_filtered_verified_and_exported(page, served, picture):
    """The page lists audit rows, states that the log is intact, filters rows, and exports CSV."""
    served.ask("PUT", "/session/start-page", {"path": ""})
    page.goto("/admin?show=audit")
    rows = page.get_by_test_id("audit-row")
    expect(rows.first).to_be_visible()
    expect(page.get_by_test_id("audit")).to_contain_text("intact:")
    picture("admin-audit")
    page.get_by_test_id("audit-result").select_option("denied")
    expect(page.locator("[data-testid=audit-row][data-result=done]")).to_have_count(0)
    page.get_by_test_id("audit-who").fill("unknown-user")
    expect(page.get_by_text("No rows match these filters.")).to_be_visible()
    with page.expect_download() as download:
        page.get_by_test_id("audit-csv").click()
    assert download.value.suggested_filename == "audit.csv"


def test_health_describes_each_check(page, picture):
    """The page lists the health checks and runs the check of the store as a job."""
    page.goto("/admin?show=health")
    expect(page.get_by_test_id("health-row").first).to_be_visible()
    assert page.get_by_test_id("health-row").count() >= 8
    page.get_by_test_id("check-store").click()
    expect(page.get_by_test_id("health").get_by_test_id("job")).to_have_attribute("data-state", "done")
    picture("admin-health")


def test_retention_previews_a_removal(page, picture):
    """Numbers out of range are rejected. A changed policy shows its effect, and after saving it can be run."""
    page.goto("/admin?show=storage")
    expect(page.get_by_test_id("storage-kind").first).to_be_visible()
    field = page.get_by_test_id("retention-telemetry_days")
    field.fill("99999")
    expect(page.get_by_text("0 – 36 500", exact=False)).to_be_visible()
    expect(page.get_by_test_id("retention-save")).to_be_disabled()
    field.fill("0.00001")
    packets = page.get_by_test_id("retention-effect").locator("tr").filter(has_text="telemetry packets").locator("td")
    expect(packets.nth(1)).to_have_text("0")
    expect(packets.nth(2)).to_have_text(re.compile(r"[1-9]"))
    picture("admin-storage")
    field.fill("365")
    page.get_by_test_id("retention-save").click()
    expect(page.get_by_test_id("retention-save")).to_be_disabled()
    page.get_by_test_id("retention-run").click()
    expect(page.get_by_test_id("retention").get_by_test_id("job")).to_have_attribute("data-state", "done")


def test_a_clock_in_doubt_is_confirmed_on_the_page(page, data_folder, picture):
    """While the clock is in doubt, the page states the reason and disables deletion until the clock is confirmed."""
    with closing(sqlite3.connect(data_folder / "gss.db", timeout=30)) as database, database:
        value = json.dumps({"at": "2016-11-22T12:00:00+00:00"})
        changed = database.execute("UPDATE choices SET value = ? WHERE name = 'upkeep.trusted-time'", (value,))
        assert changed.rowcount == 1
    page.goto("/admin?show=storage")
    expect(page.get_by_test_id("clock-doubt")).to_contain_text("days ahead of the last trusted time (2016-11-22")
    expect(page.get_by_test_id("retention-run")).to_be_disabled()
    expect(page.get_by_test_id("alarm")).to_contain_text("Server clock")
    picture("admin-clock")
    page.get_by_test_id("clock-confirm").click()
    expect(page.get_by_test_id("clock-doubt")).to_have_count(0)
    expect(page.get_by_test_id("retention-run")).to_be_enabled()


def test_an_unusual_removal_shows_its_counts_first(page, served, data_folder, picture):
    """A removal of thousands of events shows its counts first and deletes after confirmation."""
    rows = [(-k, "2020-01-01 00:00:00.000000", "test", "ok", "old", "{}") for k in range(1, 2201)]
    with closing(sqlite3.connect(data_folder / "gss.db", timeout=30)) as database, database:
        database.executemany("INSERT INTO events (seq, at, kind, severity, text, data) VALUES (?, ?, ?, ?, ?, ?)", rows)
    page.goto("/admin?show=storage")
    page.get_by_test_id("retention-events_days").fill("365")
    page.get_by_test_id("retention-save").click()
    expect(page.get_by_test_id("retention-save")).to_be_disabled()
    page.get_by_test_id("retention-run").click()
    expect(page.get_by_test_id("removal-pending")).to_contain_text("2200 of")
    picture("admin-removal")
    page.get_by_test_id("removal-confirm").click()
    expect(page.get_by_test_id("removal-pending")).to_have_count(0)
    (job,) = served.until(
        "/jobs", lambda jobs: [j for j in jobs if j["result"].get("removed", {}).get("events") == 2200]
    )
    assert job["state"] == "done"
    with closing(sqlite3.connect(data_folder / "gss.db", timeout=30)) as database:
        assert database.execute("SELECT count(*) FROM events WHERE seq < 0").fetchone() == (0,)


def test_a_backup_is_made_and_downloaded(page, picture):
    """The button starts a backup job. Afterwards the table lists the backup with a file to download."""
    page.goto("/admin?show=backup")
    expect(page.get_by_test_id("backup-now")).to_be_enabled()
    page.get_by_test_id("backup-now").click()
    expect(page.get_by_test_id("backup-row").first).to_be_visible()
    picture("admin-backup")
    with page.expect_download() as download:
        page.get_by_test_id("backup-download").first.click()
    assert download.value.suggested_filename.endswith(".tar")
