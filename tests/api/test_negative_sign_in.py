"""Security of sign-in: sessions, links, tokens, CSRF, rate limits, and the audit log."""

from __future__ import annotations

import itertools
import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.api.app import create_app
from gss.domain.limits import State
from gss.settings import Settings
from gss.wiring.build import build
from gss.wiring.services import Services

PASSWORD = "orion over the sea"


@pytest.fixture(scope="module")
def app(app_of: Callable[..., FastAPI]) -> FastAPI:
    """Server with the users ann, an admin, and vic, a viewer."""
    return app_of({"ann": ("admin", PASSWORD), "vic": ("viewer", PASSWORD + " vic")})


@pytest.fixture
def services(app: FastAPI) -> Services:
    """Services of the server."""
    services: Services = app.state.services
    return services


@pytest.fixture
def anonymous(app: FastAPI, services: Services, address: str) -> TestClient:
    """Client without a session at an address that no other test uses."""
    services.accounts.accounts.attempts._failures.clear()
    return TestClient(
        app,
        base_url="http://localhost",
        headers={"X-GSS": "1"},
        raise_server_exceptions=False,
        client=(address, 5000),
    )


HOST_NUMBERS = itertools.count(1)


@pytest.fixture
def address() -> str:
    """Network address of the anonymous client."""
    return f"10.0.0.{next(HOST_NUMBERS)}"


def sign_in(client: TestClient, name: str = "ann", password: str = PASSWORD) -> dict[str, Any]:
    """Sign in as the page does; later requests have the session's CSRF token."""
    reply = client.post("/api/session", json={"name": name, "password": password})
    assert reply.status_code == 200, reply.text
    body: dict[str, Any] = reply.json()
    client.headers["X-GSS"] = body["csrf"]
    return body


def newest_row(services: Services, action: str) -> Any:
    """Return the newest audit row of an action."""
    from gss.store.audit import AuditFilter

    return services.accounts.audit.page(AuditFilter(action=action), 1)[0]


def test_the_cookie_is_inaccessible_to_scripts_and_other_sites(anonymous: TestClient) -> None:
    """The cookie is HttpOnly, SameSite=Strict and without a domain. The response does not contain the key and is not
    cached.
    """
    reply = anonymous.post("/api/session", json={"name": "ann", "password": PASSWORD})
    morsel = reply.headers["set-cookie"]
    assert all(word in morsel for word in ("gss_session=", "HttpOnly", "SameSite=strict", "Path=/"))
    assert "Domain" not in morsel
    assert anonymous.cookies["gss_session"] not in reply.text
    assert reply.headers["cache-control"] == "no-store"
    session = anonymous.get("/api/session").json()
    assert (session["signed_in"], session["name"], session["role"], session["csrf"]) == (
        True,
        "ann",
        "admin",
        reply.json()["csrf"],
    )


def test_no_response_log_or_row_contains_a_password(services: Services, anonymous: TestClient, caplog: Any) -> None:
    """No right, wrong, too short or misplaced password is stored in a response, a log or the audit log."""
    secrets = [PASSWORD, "a wrong secret", "tiny", "typed as a name!", "a new good secret"]
    with caplog.at_level(logging.DEBUG):
        answers = [
            anonymous.post("/api/session", json={"name": "ann", "password": secrets[1]}),
            anonymous.post("/api/session", json={"name": secrets[3], "password": secrets[0]}),
            anonymous.post("/api/session", json={"name": "ann", "password": secrets[0], "more": secrets[1]}),
            anonymous.post("/api/session", json={"name": "ann", "password": [secrets[1]]}),
        ]
        sign_in(anonymous)
        answers += [
            anonymous.put("/api/session/password", json={"old": secrets[1], "new": secrets[4]}),
            anonymous.put("/api/session/password", json={"old": secrets[0], "new": secrets[2]}),
            anonymous.get("/api/users"),
            anonymous.get("/api/audit?limit=200"),
        ]
    assert [a.status_code for a in answers] == [401, 401, 422, 422, 403, 400, 200, 200]
    everything = caplog.text + "".join(a.text for a in answers) + "".join(services.accounts.audit.export("jsonl"))
    assert not [secret for secret in secrets if secret in everything]
    assert newest_row(services, "session.sign_in").who == "ann"
    assert "$argon2" not in everything


def test_an_unknown_name_is_answered_like_a_wrong_password(services: Services, anonymous: TestClient) -> None:
    """Status, text and the number of computed hashes are equal, so the response does not reveal which accounts
    exist.
    """
    answers = []
    for name in ("ann", "another user"):
        before = services.accounts.accounts.passwords.verified
        reply = anonymous.post("/api/session", json={"name": name, "password": "not this one"})
        body = reply.json() | {"id": ""}
        answers.append((reply.status_code, body, services.accounts.accounts.passwords.verified - before))
    assert answers[0] == answers[1]
    assert answers[0][2] == 1


def test_brute_force_is_rate_limited(anonymous: TestClient) -> None:
    """After some failures every attempt is a 429 with Retry-After, also with the right password."""
    codes = [
        anonymous.post("/api/session", json={"name": "ann", "password": f"guess number {k}"}).status_code
        for k in range(8)
    ]
    assert codes[0] == 401
    assert codes[-1] == 429
    reply = anonymous.post("/api/session", json={"name": "ann", "password": PASSWORD})
    assert reply.status_code == 429
    assert 1 <= int(reply.headers["retry-after"]) <= 30


def test_a_planted_session_is_invalid(services: Services, anonymous: TestClient) -> None:
    """The server does not accept a planted key (session fixation). Another sign-in in the same browser ends the
    session.
    """
    anonymous.cookies.set("gss_session", "planted-key", domain="localhost.local")
    sign_in(anonymous)
    first = anonymous.cookies.get("gss_session", domain="localhost.local")
    assert first != "planted-key"
    assert services.accounts.accounts.session_caller("planted-key") is None
    anonymous.headers["X-GSS"] = "1"
    sign_in(anonymous, "vic", PASSWORD + " vic")
    assert services.accounts.accounts.session_caller(first) is None


def test_signing_out_ends_the_session_permanently(services: Services, anonymous: TestClient) -> None:
    """After signing out, a copied cookie is invalid."""
    sign_in(anonymous)
    key = anonymous.cookies["gss_session"]
    assert anonymous.delete("/api/session").status_code == 204
    assert services.accounts.accounts.session_caller(key) is None
    anonymous.cookies.set("gss_session", key)
    assert anonymous.get("/api/link").json()["message"] == "The session has ended."


@pytest.mark.parametrize("mark", [None, "", "1", "0" * 64])
def test_a_change_without_the_sessions_csrf_token_is_rejected(anonymous: TestClient, mark: str | None) -> None:
    """A change with a missing, empty, constant or guessed CSRF token is rejected."""
    sign_in(anonymous)
    del anonymous.headers["X-GSS"]
    reply = anonymous.post("/api/authority/take", headers={} if mark is None else {"X-GSS": mark})
    assert (reply.status_code, reply.json()["message"]) == (403, "The CSRF token is missing or wrong.")


def test_the_csrf_token_of_another_session_is_rejected(services: Services, anonymous: TestClient) -> None:
    """The CSRF token is bound to its session."""
    ann = sign_in(anonymous)
    anonymous.headers["X-GSS"] = "1"
    sign_in(anonymous, "vic", PASSWORD + " vic")
    reply = anonymous.delete("/api/session", headers={"X-GSS": ann["csrf"]})
    assert reply.status_code == 403


def test_a_password_change_ends_every_other_session_and_renews_ones_own(
    services: Services, anonymous: TestClient
) -> None:
    """After a password change the user has a new cookie and CSRF token. Old sessions and unused links are invalid."""
    user = services.accounts.accounts.users.add("pat", "operator", by="test", password=PASSWORD)
    elsewhere = services.accounts.accounts.sessions.begin(user, address="other desk")
    link = services.accounts.accounts.users.password_link(user.id, by="test")
    before = sign_in(anonymous, "pat")
    key = anonymous.cookies["gss_session"]
    reply = anonymous.put("/api/session/password", json={"old": PASSWORD, "new": "vega above the hills"})
    assert reply.status_code == 200
    assert reply.json()["csrf"] != before["csrf"]
    assert services.accounts.accounts.session_caller(elsewhere.key) is None
    assert services.accounts.accounts.session_caller(key) is None
    assert anonymous.get("/api/session").json()["name"] == "pat"
    body = {"token": link.key, "password": "another good one"}
    assert anonymous.post("/api/password-links", json=body).status_code == 403


def test_a_disabled_user_is_signed_out_at_once(services: Services, anonymous: TestClient) -> None:
    """The requests and the sign-in of a disabled user are rejected."""
    user = services.accounts.accounts.users.add("off", "operator", by="test", password=PASSWORD)
    sign_in(anonymous, "off")
    assert anonymous.get("/api/link").status_code == 200
    services.accounts.accounts.users.change(user.id, enabled=False)
    assert anonymous.get("/api/link").status_code == 401
    assert anonymous.post("/api/session", json={"name": "off", "password": PASSWORD}).status_code == 401


def test_links_are_used_once_and_not_guessed(services: Services, anonymous: TestClient) -> None:
    """A link sets the first password of a user. A second use, a guess and the use as a setup link have the same
    rejection.
    """
    user = services.accounts.accounts.users.add("new", "viewer", by="test")
    assert anonymous.post("/api/session", json={"name": "new", "password": ""}).status_code == 422
    link = services.accounts.accounts.users.password_link(user.id, by="test")
    body = {"token": link.key, "password": "cassiopeia upside down"}
    rejected = [
        anonymous.post("/api/password-links", json=body | {"token": "guess"}),
        anonymous.post("/api/setup", json={"token": link.key, "name": "eve", "password": PASSWORD}),
    ]
    assert anonymous.post("/api/password-links", json=body).json()["name"] == "new"
    rejected.append(anonymous.post("/api/password-links", json=body))
    assert [(r.status_code, r.json()["message"]) for r in rejected] == [
        (403, "This link is invalid, expired or already used.")
    ] * 3


def test_the_first_admin_is_created_with_the_printed_link_only(tmp_path: Path) -> None:
    """On a server without users no data are readable and no password is valid. Guesses of the setup link are
    rate-limited, and the link works once.
    """
    services = build(Settings(data=tmp_path / "data", password_memory_kib=8, password_passes=1))
    with TestClient(create_app(services), base_url="http://localhost", headers={"X-GSS": "1"}) as client:
        assert client.get("/api/session").json()["set_up_needed"] is True
        assert client.get("/api/link").status_code == 401
        for name, password in (("admin", "admin"), ("operator-1", "operator-1"), ("root", "password")):
            assert client.post("/api/session", json={"name": name, "password": password}).status_code == 401
        link = services.accounts.accounts.users.set_up_link()
        assert link is not None
        body = {"token": "guess", "name": "ann", "password": PASSWORD}
        codes = {client.post("/api/setup", json=body | {"token": f"guess {k}"}).status_code for k in range(20)}
        assert codes == {403, 429}
        services.accounts.accounts.attempts.forget("link testclient")
        user = client.post("/api/setup", json=body | {"token": link.key}).json()
        assert (user["name"], user["role"]) == ("ann", "admin")
        assert client.post("/api/setup", json=body | {"token": link.key, "name": "eve"}).status_code == 403
        assert [user.name for user in services.accounts.accounts.users.list_all()] == ["ann"]


@pytest.mark.parametrize("key", ["", "gss_", "gss_guess", "x" * 5000, "gss_\x7f"])
def test_an_invalid_token_is_rejected(anonymous: TestClient, key: str) -> None:
    """Empty, guessed, very long and malformed tokens are rejected."""
    reply = anonymous.get("/api/link", headers={"Authorization": f"Bearer {key}"})
    assert reply.status_code in (401, 429)


def test_a_token_needs_no_csrf_token_and_has_its_role_only(services: Services, anonymous: TestClient) -> None:
    """A client makes changes with its token and without a CSRF token. It cannot change passwords or raise its
    permissions. A revoked token is invalid at once.
    """
    token = services.accounts.accounts.tokens.add("night run", "engineer", 1, by="test")
    headers = {"Authorization": f"Bearer {token.key}"}
    del anonymous.headers["X-GSS"]
    assert anonymous.post("/api/authority/take", headers=headers).json()["holder"] == "token:night run"
    assert anonymous.post("/api/authority/release", headers=headers).status_code == 200
    assert anonymous.post("/api/link/close", headers=headers).status_code == 403
    change = {"old": PASSWORD, "new": "a new good secret"}
    assert anonymous.put("/api/session/password", headers=headers, json=change).status_code == 409
    limited = services.accounts.accounts.tokens.add("narrow", "admin", 1, by="test", scopes=["admin.tokens"])
    limited_headers = {"Authorization": f"Bearer {limited.key}"}
    assert anonymous.get("/api/link", headers=limited_headers).status_code == 403
    wider = anonymous.post("/api/tokens", headers=limited_headers, json={"name": "wider", "role": "admin", "days": 1})
    assert wider.status_code == 403
    services.accounts.accounts.tokens.revoke(token.row.id)
    assert anonymous.get("/api/link", headers=headers).status_code == 401


def test_a_token_is_shown_once(services: Services, anonymous: TestClient) -> None:
    """The key of a token is only in the response that creates it."""
    sign_in(anonymous)
    key = anonymous.post("/api/tokens", json={"name": "once", "role": "viewer", "days": 1}).json()["key"]
    after = anonymous.get("/api/tokens").text + anonymous.get("/api/audit?limit=50").text
    assert key not in after
    assert key not in "".join(services.accounts.audit.export("jsonl"))


def test_the_audit_log_records_actions_without_secrets(services: Services, anonymous: TestClient) -> None:
    """The audit log records commands with arguments, roles, tokens and policies. A failed action has the attempt and
    the reason. One-time links are not recorded.
    """
    sign_in(anonymous)
    anonymous.post("/api/commands", json={"name": "SET_EXPOSURE", "arguments": {"exposure_ms": 150}})
    failed = newest_row(services, "commands.send_command")
    assert failed.detail.startswith("SET_EXPOSURE exposure_ms=150: ")
    added = anonymous.post("/api/users", json={"name": "dee", "role": "viewer"}).json()
    assert newest_row(services, "users.add_user").detail == "dee as viewer"
    anonymous.put(f"/api/users/{added['user']['id']}", json={"role": "engineer", "enabled": False})
    assert newest_row(services, "users.change_user").detail == "dee from viewer to engineer deactivated"
    anonymous.post("/api/tokens", json={"name": "prom", "role": "viewer", "days": 1, "scopes": ["metrics"]})
    assert newest_row(services, "tokens.add_token").detail == "prom as viewer for 1 days, only metrics"
    anonymous.put("/api/admin/retention", json={"frames_days": 30})
    assert newest_row(services, "upkeep.choose_retention").detail == "frames_days from 0 to 30"
    anonymous.post("/api/authority/break", json={"reason": "pass begins"})
    assert newest_row(services, "authority.break_authority").detail.startswith("of no user, pass begins: ")
    assert added["link"].split("#")[1] not in "".join(services.accounts.audit.export("jsonl"))


def test_the_audit_log_records_old_and_new_values(services: Services, anonymous: TestClient) -> None:
    """Changes of limits, alarms, tables, procedures, schedule and link are recorded with old value, new value and
    reason.
    """
    sign_in(anonymous)
    limits = {"watch": [None, 30], "warning": [None, 40], "critical": [None, 50], "persistence": 2, "note": "hot night"}
    anonymous.put("/api/telemetry/limits/housekeeping.sensor_temperature_c", json=limits)
    detail = newest_row(services, "limits.override").detail
    assert detail.startswith("housekeeping.sensor_temperature_c from watch ")
    assert detail.endswith(" to watch … 30, warning … 40, critical … 50, 2 samples hot night")
    anonymous.delete("/api/telemetry/limits/housekeeping.sensor_temperature_c")
    detail = newest_row(services, "limits.restore").detail
    assert detail.startswith(
        "housekeeping.sensor_temperature_c from watch … 30, warning … 40, critical … 50, 2 samples to "
    )
    before, other = services.telemetry.telemetry.limits.chosen, services.telemetry.telemetry.limits.sets[-1][0]
    anonymous.put("/api/telemetry/limits/set", json={"name": other, "note": "bench"})
    assert newest_row(services, "limits.choose_set").detail == f"from {before} to {other} bench"
    services.telemetry.alarms.watch(("link", "test"), State.WARNING, 1.0, "a test", "")
    (alarm,) = services.telemetry.alarms.opened()
    anonymous.post(f"/api/alarms/{alarm.row.id}/shelve", json={"minutes": 10, "note": "known"})
    assert newest_row(services, "alarms.shelve").detail.endswith("raised; for 10 min known")
    anonymous.post(f"/api/alarms/{alarm.row.id}/unshelve", json={"note": "again"})
    assert newest_row(services, "alarms.unshelve").detail.endswith("shelved; again")
    table = {"kind": "parameters", "name": "dark", "profile": "cubestar", "content": {"threshold_dn": 30}}
    stored = anonymous.post("/api/tables", json=table).json()
    assert newest_row(services, "tables.create_table").detail == "parameters dark of cubestar: threshold_dn"
    anonymous.post(f"/api/tables/{stored['id']}/upload", json={"bank": "2"})
    assert newest_row(services, "tables.upload_table").detail.startswith("parameters dark to bank 2")
    text = "# Evening\n\n## a: Send\n```command\nPOWER state=off\n```\n"
    procedure = anonymous.post("/api/procedures", json={"text": text}).json()
    change = {"text": text.replace("Evening", "Night"), "sha256": procedure["sha256"]}
    anonymous.put(f"/api/procedures/{procedure['id']}", json=change)
    detail = newest_row(services, "procedures.change_procedure").detail
    assert detail == f"Evening: from {len(text)} to {len(text) - 2} characters"
    start = {"automatic": True, "confirm": ["POWER"]}
    anonymous.post(f"/api/procedures/{procedure['id']}/start", json=start)
    assert newest_row(services, "procedures.start_procedure").detail.startswith("Night automatic POWER: ")
    order = {"command": "SET_EXPOSURE", "arguments": {"exposure_ms": 300}, "at": "2100-01-01T00:00:00Z"}
    anonymous.post("/api/schedule", json=order)
    detail = newest_row(services, "schedule.schedule_command").detail
    assert detail.startswith("SET_EXPOSURE exposure_ms=300 at 2100-01-01T00:00:00")
    anonymous.post("/api/calibrations/documented", json={"profile": "cubestar"})
    detail = newest_row(services, "calibrations.use_documented").detail
    assert detail.startswith("cubestar from documented to documented: no calibration is active")
    anonymous.post("/api/link/open", json={"url": "carrier-pigeon://coop"})
    assert newest_row(services, "link.open_link").detail.startswith("from closed to carrier-pigeon://coop: ")
    anonymous.post("/api/link/close")
    assert newest_row(services, "link.close_link").detail.startswith("closed")


def test_every_change_denial_and_export_is_audited(services: Services, anonymous: TestClient, address: str) -> None:
    """Changes, denials and exports are recorded with user, action, address and result. Reads are not recorded, and
    repeated unauthenticated requests share a row.
    """
    rows_before = services.accounts.audit.verify().rows
    for _ in range(30):
        anonymous.get("/api/link")
    assert services.accounts.audit.verify().rows == rows_before + 1
    sign_in(anonymous, "vic", PASSWORD + " vic")
    row = newest_row(services, "session.sign_in")
    assert (row.who, row.result, row.address) == ("vic", "done", address)
    rows = services.accounts.audit.verify().rows
    assert anonymous.get("/api/link").status_code == 200
    assert services.accounts.audit.verify().rows == rows
    assert anonymous.post("/api/link/close").status_code == 403
    denied = newest_row(services, "link.close_link")
    assert (denied.who, denied.role, denied.result) == ("vic", "viewer", "denied")
    assert "link.open" in denied.detail
    assert anonymous.get("/api/commands.csv").status_code == 200
    assert newest_row(services, "commands.export_commands").result == "done"
    assert anonymous.post("/api/commands/abort").status_code == 409
    assert (newest_row(services, "commands.abort").result, newest_row(services, "commands.abort").who) == (
        "failed",
        "vic",
    )
    assert services.accounts.audit.verify().problem == ""


def test_the_record_cannot_be_changed_over_the_network(anonymous: TestClient) -> None:
    """No route changes the audit log, not even for an admin."""
    sign_in(anonymous)
    for method, path in (
        ("DELETE", "/api/audit"),
        ("PUT", "/api/audit/1"),
        ("POST", "/api/audit"),
        ("DELETE", "/api/audit/1"),
    ):
        assert anonymous.request(method, path, json={}).status_code in (404, 405)


@pytest.mark.parametrize(
    "query",
    [
        {"who": "ann' OR '1'='1"},
        {"action": "%"},
        {"action": "session' UNION SELECT name, password_hash FROM users --"},
        {"since": "2026-01-01' OR 1=1"},
        {"before": "1; DROP TABLE audit"},
        {"until": "9999-12-31"},
    ],
)
def test_filters_of_the_audit_log_are_values_never_sql(
    services: Services, anonymous: TestClient, query: dict[str, str]
) -> None:
    """SQL in a filter gives no rows or a 422, and the audit log stays complete."""
    sign_in(anonymous)
    reply = anonymous.get("/api/audit", params=query)
    assert reply.status_code in (200, 422)
    assert "argon2" not in reply.text
    if "until" not in query and reply.status_code == 200:
        assert reply.json() == []
    assert services.accounts.audit.verify().problem == ""


def test_no_page_stores_a_secret_accessible_to_scripts(root: Path) -> None:
    """The source of the pages stores no secret in localStorage or sessionStorage and writes no cookie."""
    for path in (root / "web" / "src").rglob("*"):
        if path.suffix in (".ts", ".svelte") and not path.name.endswith(".test.ts"):
            text = path.read_text()
            assert "document.cookie" not in text, path
            for line in text.splitlines():
                if "localStorage" in line or "sessionStorage" in line:
                    assert not any(word in line.lower() for word in ("password", "csrf", "token", "mark")), (
                        f"{path}: {line}"
                    )


def test_json_of_the_session_has_the_fields_that_pages_read(anonymous: TestClient) -> None:
    """The response has the same fields with and without a session."""
    fields = {"signed_in", "name", "role", "permissions", "csrf", "expires", "set_up_needed", "several_units"}
    fields |= {"start_page", "role_start_page"}
    assert set(anonymous.get("/api/session").json()) == fields
    assert set(json.loads(json.dumps(sign_in(anonymous)))) == fields


def test_the_audit_log_names_what_a_revocation_withdrew(services: Services, anonymous: TestClient) -> None:
    """The audit log names the disabled users and counts the invalidated links. The list of users shows the reason."""
    ann = services.accounts.accounts.users.named("ann")
    token = services.accounts.accounts.tokens.add("robot", "admin", 1, by="ann", owner_id=ann.id)
    robot = {"Authorization": f"Bearer {token.key}"}
    assert anonymous.post("/api/users", headers=robot, json={"name": "made", "role": "viewer"}).status_code == 201
    sign_in(anonymous)
    assert anonymous.delete(f"/api/tokens/{token.row.id}").status_code == 204
    assert newest_row(services, "tokens.revoke_token").detail == "robot also disabled: made; links invalidated: 1"
    user = next(user for user in anonymous.get("/api/users").json() if user["name"] == "made")
    assert (user["enabled"], user["disabled_reason"]) == (False, "created by token:robot, which was revoked")
