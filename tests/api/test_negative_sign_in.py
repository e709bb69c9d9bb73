"""What signing in must never do. Sessions, links, tokens, CSRF, brakes, and what is written down of it all."""

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
from gss.wiring import Services, build

PASSWORD = "orion over the sea"


@pytest.fixture(scope="module")
def app(app_of: Callable[..., FastAPI]) -> FastAPI:
    """A server with ann, an admin, and vic, a viewer, who have passwords."""
    return app_of({"ann": ("admin", PASSWORD), "vic": ("viewer", PASSWORD + " vic")})


@pytest.fixture
def services(app: FastAPI) -> Services:
    """Behind it."""
    services: Services = app.state.services
    return services


@pytest.fixture
def stranger(app: FastAPI, services: Services, address: str) -> TestClient:
    """A browser that nobody has signed in with, at an address of its own."""
    services.accounts.attempts._failures.clear()
    return TestClient(
        app,
        base_url="http://localhost",
        headers={"X-GSS": "1"},
        raise_server_exceptions=False,
        client=(address, 5000),
    )


NUMBERS = itertools.count(1)


@pytest.fixture
def address() -> str:
    """Of the stranger."""
    return f"10.0.0.{next(NUMBERS)}"


def sign_in(client: TestClient, name: str = "ann", password: str = PASSWORD) -> dict[str, Any]:
    """Sign in as the page does; later requests carry the session's mark."""
    reply = client.post("/api/session", json={"name": name, "password": password})
    assert reply.status_code == 200, reply.text
    body: dict[str, Any] = reply.json()
    client.headers["X-GSS"] = body["csrf"]
    return body


def newest(services: Services, action: str) -> Any:
    """The newest row of an action on the record."""
    from gss.store.audit import AuditFilter

    return services.audit.page(AuditFilter(action=action), 1)[0]


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(stranger: TestClient) -> None:
    """HttpOnly, SameSite=Strict, no domain; the key is in no answer, and no answer may be kept by a cache."""
    reply = stranger.post("/api/session", json={"name": "ann", "password": PASSWORD})
    morsel = reply.headers["set-cookie"]
    assert all(word in morsel for word in ("gss_session=", "HttpOnly", "SameSite=strict", "Path=/"))
    assert "Domain" not in morsel
    assert stranger.cookies["gss_session"] not in reply.text
    assert reply.headers["cache-control"] == "no-store"
    told = stranger.get("/api/session").json()
    assert (told["signed_in"], told["name"], told["role"], told["csrf"]) == (True, "ann", "admin", reply.json()["csrf"])


def test_no_answer_log_or_row_holds_a_password(services: Services, stranger: TestClient, caplog: Any) -> None:
    """Right, wrong, too short, typed into the wrong field: it is nowhere afterwards."""
    secrets = [PASSWORD, "a wrong secret", "tiny", "typed as a name!", "a new good secret"]
    with caplog.at_level(logging.DEBUG):
        answers = [
            stranger.post("/api/session", json={"name": "ann", "password": secrets[1]}),
            stranger.post("/api/session", json={"name": secrets[3], "password": secrets[0]}),
            stranger.post("/api/session", json={"name": "ann", "password": secrets[0], "more": secrets[1]}),
            stranger.post("/api/session", json={"name": "ann", "password": [secrets[1]]}),
        ]
        sign_in(stranger)
        answers += [
            stranger.put("/api/session/password", json={"old": secrets[1], "new": secrets[4]}),
            stranger.put("/api/session/password", json={"old": secrets[0], "new": secrets[2]}),
            stranger.get("/api/users"),
            stranger.get("/api/audit?limit=200"),
        ]
    assert [a.status_code for a in answers] == [401, 401, 422, 422, 403, 400, 200, 200]
    everything = caplog.text + "".join(a.text for a in answers) + "".join(services.audit.export("jsonl"))
    assert not [secret for secret in secrets if secret in everything]
    assert newest(services, "session.sign_in").who == "ann"
    assert "$argon2" not in everything


def test_an_unknown_name_is_answered_like_a_wrong_password(services: Services, stranger: TestClient) -> None:
    """Same status, same words, one hash computed: nobody learns who has an account."""
    answers = []
    for name in ("ann", "somebody else"):
        before = services.accounts.passwords.verified
        reply = stranger.post("/api/session", json={"name": name, "password": "not this one"})
        body = reply.json() | {"id": ""}
        answers.append((reply.status_code, body, services.accounts.passwords.verified - before))
    assert answers[0] == answers[1]
    assert answers[0][2] == 1


def test_brute_force_is_told_to_wait(stranger: TestClient) -> None:
    """After some failures 429 with Retry-After, for the right password too; it is on the record as denied."""
    codes = [
        stranger.post("/api/session", json={"name": "ann", "password": f"guess number {k}"}).status_code
        for k in range(8)
    ]
    assert codes[0] == 401
    assert codes[-1] == 429
    reply = stranger.post("/api/session", json={"name": "ann", "password": PASSWORD})
    assert reply.status_code == 429
    assert 1 <= int(reply.headers["retry-after"]) <= 30


def test_a_session_that_was_planted_is_worth_nothing(services: Services, stranger: TestClient) -> None:
    """Session fixation: a key from outside is not taken over, and a living one ends when another sign-in uses its browser."""
    stranger.cookies.set("gss_session", "planted-by-somebody", domain="localhost.local")
    sign_in(stranger)
    first = stranger.cookies.get("gss_session", domain="localhost.local")
    assert first != "planted-by-somebody"
    assert services.accounts.who_has_cookie("planted-by-somebody") is None
    stranger.headers["X-GSS"] = "1"
    sign_in(stranger, "vic", PASSWORD + " vic")
    assert services.accounts.who_has_cookie(first) is None


def test_signing_out_ends_the_session_for_good(services: Services, stranger: TestClient) -> None:
    """Whoever kept the cookie has nothing."""
    sign_in(stranger)
    key = stranger.cookies["gss_session"]
    assert stranger.delete("/api/session").status_code == 204
    assert services.accounts.who_has_cookie(key) is None
    stranger.cookies.set("gss_session", key)
    assert stranger.get("/api/link").json()["message"] == "the session has ended"


@pytest.mark.parametrize("mark", [None, "", "1", "0" * 64])
def test_a_change_without_the_sessions_own_mark_is_refused(stranger: TestClient, mark: str | None) -> None:
    """CSRF: none, empty, the old constant, a guess."""
    sign_in(stranger)
    del stranger.headers["X-GSS"]
    reply = stranger.post("/api/authority/take", headers={} if mark is None else {"X-GSS": mark})
    assert (reply.status_code, reply.json()["message"]) == (403, "a change needs the session's own mark")


def test_the_mark_of_another_session_is_refused(services: Services, stranger: TestClient) -> None:
    """It is bound to the session, not to the server."""
    ann = sign_in(stranger)
    stranger.headers["X-GSS"] = "1"
    sign_in(stranger, "vic", PASSWORD + " vic")
    reply = stranger.delete("/api/session", headers={"X-GSS": ann["csrf"]})
    assert reply.status_code == 403


def test_a_password_change_ends_every_other_session_and_renews_ones_own(
    services: Services, stranger: TestClient
) -> None:
    """New cookie, new mark; the old ones are worth nothing anywhere; a link that was on its way neither."""
    user = services.accounts.users.add("pat", "operator", by="test", password=PASSWORD)
    elsewhere = services.accounts.sessions.begin(user.id, address="other desk")
    link = services.accounts.users.password_link(user.id)
    before = sign_in(stranger, "pat")
    key = stranger.cookies["gss_session"]
    reply = stranger.put("/api/session/password", json={"old": PASSWORD, "new": "vega above the hills"})
    assert reply.status_code == 200
    assert reply.json()["csrf"] != before["csrf"]
    assert services.accounts.who_has_cookie(elsewhere.key) is None
    assert services.accounts.who_has_cookie(key) is None
    assert stranger.get("/api/session").json()["name"] == "pat"
    body = {"token": link.key, "password": "another good one"}
    assert stranger.post("/api/password-links", json=body).status_code == 403


def test_a_user_who_is_switched_off_is_out_at_once(services: Services, stranger: TestClient) -> None:
    """In the middle of a session, and at the next sign-in."""
    user = services.accounts.users.add("off", "operator", by="test", password=PASSWORD)
    sign_in(stranger, "off")
    assert stranger.get("/api/link").status_code == 200
    services.accounts.users.change(user.id, enabled=False)
    assert stranger.get("/api/link").status_code == 401
    assert stranger.post("/api/session", json={"name": "off", "password": PASSWORD}).status_code == 401


def test_links_are_used_once_and_not_guessed(services: Services, stranger: TestClient) -> None:
    """A user's first password comes by a link; the second use, a guess and a set-up link after the first user are refused alike."""
    user = services.accounts.users.add("new", "viewer", by="test")
    assert stranger.post("/api/session", json={"name": "new", "password": ""}).status_code == 422
    link = services.accounts.users.password_link(user.id)
    body = {"token": link.key, "password": "cassiopeia upside down"}
    refused = [
        stranger.post("/api/password-links", json=body | {"token": "guess"}),
        stranger.post("/api/setup", json={"token": link.key, "name": "eve", "password": PASSWORD}),
    ]
    assert stranger.post("/api/password-links", json=body).json()["name"] == "new"
    refused.append(stranger.post("/api/password-links", json=body))
    assert [(r.status_code, r.json()["message"]) for r in refused] == [(403, "this link cannot be used")] * 3


def test_the_first_admin_is_made_with_the_printed_link_only(tmp_path: Path) -> None:
    """An empty server: nothing is open, no password is known, guesses at the link are braked, the link works once."""
    services = build(Settings(data=tmp_path / "data", password_memory_kib=8, password_passes=1))
    with TestClient(create_app(services), base_url="http://localhost", headers={"X-GSS": "1"}) as client:
        assert client.get("/api/session").json()["set_up_needed"] is True
        assert client.get("/api/link").status_code == 401
        for name, password in (("admin", "admin"), ("operator-1", "operator-1"), ("root", "password")):
            assert client.post("/api/session", json={"name": name, "password": password}).status_code == 401
        link = services.accounts.users.set_up_link()
        assert link is not None
        body = {"token": "guess", "name": "ann", "password": PASSWORD}
        codes = {client.post("/api/setup", json=body | {"token": f"guess {k}"}).status_code for k in range(20)}
        assert codes == {403, 429}
        services.accounts.attempts.forget("link testclient")
        made = client.post("/api/setup", json=body | {"token": link.key}).json()
        assert (made["name"], made["role"]) == ("ann", "admin")
        assert client.post("/api/setup", json=body | {"token": link.key, "name": "eve"}).status_code == 403
        assert [user.name for user in services.accounts.users.every()] == ["ann"]


@pytest.mark.parametrize("key", ["", "gss_", "gss_guess", "x" * 5000, "gss_\x7f"])
def test_a_token_that_is_none_opens_nothing(stranger: TestClient, key: str) -> None:
    """Empty, guessed, huge."""
    reply = stranger.get("/api/link", headers={"Authorization": f"Bearer {key}"})
    assert reply.status_code in (401, 429)


def test_a_token_needs_no_mark_and_has_its_role_only(services: Services, stranger: TestClient) -> None:
    """A program changes with its token; scopes hold; revoked it is out at once; it cannot set passwords or outgrow itself."""
    made = services.accounts.tokens.add("night run", "engineer", 1, by="test")
    headers = {"Authorization": f"Bearer {made.key}"}
    del stranger.headers["X-GSS"]
    assert stranger.post("/api/authority/take", headers=headers).json()["holder"] == "token:night run"
    assert stranger.post("/api/authority/release", headers=headers).status_code == 200
    assert stranger.post("/api/link/close", headers=headers).status_code == 403
    change = {"old": PASSWORD, "new": "a new good secret"}
    assert stranger.put("/api/session/password", headers=headers, json=change).status_code == 409
    narrow = services.accounts.tokens.add("narrow", "admin", 1, by="test", scopes=["admin.tokens"])
    tight = {"Authorization": f"Bearer {narrow.key}"}
    assert stranger.get("/api/link", headers=tight).status_code == 403
    wider = stranger.post("/api/tokens", headers=tight, json={"name": "wider", "role": "admin", "days": 1})
    assert wider.status_code == 403
    services.accounts.tokens.revoke(made.row.id)
    assert stranger.get("/api/link", headers=headers).status_code == 401


def test_a_token_is_shown_once(services: Services, stranger: TestClient) -> None:
    """In the answer that makes it, and nowhere after."""
    sign_in(stranger)
    key = stranger.post("/api/tokens", json={"name": "once", "role": "viewer", "days": 1}).json()["key"]
    after = stranger.get("/api/tokens").text + stranger.get("/api/audit?limit=50").text
    assert key not in after
    assert key not in "".join(services.audit.export("jsonl"))


def test_the_record_says_what_was_done_and_no_secret(services: Services, stranger: TestClient) -> None:
    """Which command with what, whose role, which token, which policy; a deed that fails says what was tried and why not."""
    sign_in(stranger)
    stranger.post("/api/commands", json={"name": "SET_EXPOSURE", "arguments": {"exposure_ms": 150}})
    failed = newest(services, "commands.send_command")
    assert failed.detail.startswith("SET_EXPOSURE exposure_ms=150: ")
    made = stranger.post("/api/users", json={"name": "dee", "role": "viewer"}).json()
    assert newest(services, "users.add_user").detail == "dee as viewer"
    stranger.put(f"/api/users/{made['user']['id']}", json={"role": "engineer", "enabled": False})
    assert newest(services, "users.change_user").detail == "dee from viewer to engineer switched off"
    stranger.post("/api/tokens", json={"name": "prom", "role": "viewer", "days": 1, "scopes": ["metrics"]})
    assert newest(services, "tokens.add_token").detail == "prom as viewer for 1 days, only metrics"
    stranger.put("/api/admin/retention", json={"frames_days": 30})
    assert newest(services, "upkeep.choose_retention").detail == "frames_days from 0 to 30"
    stranger.post("/api/authority/break", json={"reason": "pass begins"})
    assert newest(services, "authority.break_authority").detail.startswith("of nobody, pass begins: ")
    assert made["link"].split("#")[1] not in "".join(services.audit.export("jsonl"))


def test_the_record_says_from_what_to_what(services: Services, stranger: TestClient) -> None:
    """Limits, alarms, tables and the line: what it was, what it was to be, and the words that were given."""
    sign_in(stranger)
    own = {"watch": [None, 30], "warning": [None, 40], "critical": [None, 50], "persistence": 2, "note": "hot night"}
    stranger.put("/api/telemetry/limits/housekeeping.sensor_temperature_c", json=own)
    said = newest(services, "limits.override").detail
    assert said.startswith("housekeeping.sensor_temperature_c from watch ")
    assert said.endswith(" to watch … 30, warning … 40, critical … 50, 2 samples hot night")
    stranger.delete("/api/telemetry/limits/housekeeping.sensor_temperature_c")
    said = newest(services, "limits.restore").detail
    assert said.startswith(
        "housekeeping.sensor_temperature_c from watch … 30, warning … 40, critical … 50, 2 samples to "
    )
    before, other = services.telemetry.limits.chosen, services.telemetry.limits.sets[-1][0]
    stranger.put("/api/telemetry/limits/set", json={"name": other, "note": "bench"})
    assert newest(services, "limits.choose_set").detail == f"from {before} to {other} bench"
    services.alarms.watch(("link", "test"), State.WARNING, 1.0, "a test", "")
    (alarm,) = services.alarms.opened()
    stranger.post(f"/api/alarms/{alarm.row.id}/shelve", json={"minutes": 10, "note": "known"})
    assert newest(services, "alarms.shelve").detail.endswith("raised; for 10 min known")
    stranger.post(f"/api/alarms/{alarm.row.id}/unshelve", json={"note": "again"})
    assert newest(services, "alarms.unshelve").detail.endswith("shelved; again")
    table = {"kind": "parameters", "name": "dark", "profile": "cubestar", "content": {"threshold_dn": 30}}
    made = stranger.post("/api/tables", json=table).json()
    assert newest(services, "tables.create_table").detail == "parameters dark of cubestar: threshold_dn"
    stranger.post(f"/api/tables/{made['id']}/upload", json={"bank": "2"})
    assert newest(services, "tables.upload_table").detail.startswith("parameters dark to bank 2")
    steps = [{"command": "GET_STATUS"}, {"command": "POWER", "arguments": {"state": "off"}}]
    stack = stranger.post("/api/stacks", json={"name": "evening", "steps": steps}).json()
    stranger.put(f"/api/stacks/{stack['id']}", json={"name": "night", "steps": steps[:1]})
    assert newest(services, "stacks.change_stack").detail == "from evening (GET_STATUS, POWER) to night (GET_STATUS)"
    stranger.post(f"/api/stacks/{stack['id']}/run", json={"confirm": []})
    assert newest(services, "stacks.run_stack").detail.startswith("night (GET_STATUS): ")
    order = {"command": "SET_EXPOSURE", "arguments": {"exposure_ms": 300}, "at": "2100-01-01T00:00:00Z"}
    stranger.post("/api/schedule", json=order)
    said = newest(services, "schedule.schedule_command").detail
    assert said.startswith("SET_EXPOSURE exposure_ms=300 at 2100-01-01T00:00:00")
    stranger.post("/api/calibrations/documented", json={"profile": "cubestar"})
    said = newest(services, "calibrations.use_documented").detail
    assert said.startswith("cubestar from documented to documented: no calibration is in use")
    stranger.post("/api/link/open", json={"url": "carrier-pigeon://coop"})
    assert newest(services, "link.open_link").detail.startswith("from closed to carrier-pigeon://coop: ")
    stranger.post("/api/link/close")
    assert newest(services, "link.close_link").detail.startswith("closed")


def test_every_deed_denial_and_export_is_on_the_record(services: Services, stranger: TestClient, address: str) -> None:
    """Who, what, from where, how it ended; looking is not; strangers' knocking is counted and not written each time."""
    knocks = services.audit.verify().rows
    for _ in range(30):
        stranger.get("/api/link")
    assert services.audit.verify().rows == knocks + 1
    sign_in(stranger, "vic", PASSWORD + " vic")
    row = newest(services, "session.sign_in")
    assert (row.who, row.result, row.address) == ("vic", "done", address)
    rows = services.audit.verify().rows
    assert stranger.get("/api/link").status_code == 200
    assert services.audit.verify().rows == rows
    assert stranger.post("/api/link/close").status_code == 403
    denied = newest(services, "link.close_link")
    assert (denied.who, denied.role, denied.result) == ("vic", "viewer", "denied")
    assert "link.open" in denied.detail
    assert stranger.get("/api/commands.csv").status_code == 200
    assert newest(services, "commands.export_commands").result == "done"
    assert stranger.post("/api/commands/abort").status_code == 409
    assert (newest(services, "commands.abort").result, newest(services, "commands.abort").who) == ("failed", "vic")
    assert services.audit.verify().problem == ""


def test_the_record_cannot_be_changed_over_the_network(stranger: TestClient) -> None:
    """Not even by an admin: there is no such route."""
    sign_in(stranger)
    for method, path in (
        ("DELETE", "/api/audit"),
        ("PUT", "/api/audit/1"),
        ("POST", "/api/audit"),
        ("DELETE", "/api/audit/1"),
    ):
        assert stranger.request(method, path, json={}).status_code in (404, 405)


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
def test_filters_of_the_record_are_values_never_sql(
    services: Services, stranger: TestClient, query: dict[str, str]
) -> None:
    """Nothing found, or a 422; the record stays whole."""
    sign_in(stranger)
    reply = stranger.get("/api/audit", params=query)
    assert reply.status_code in (200, 422)
    assert "argon2" not in reply.text
    if "until" not in query and reply.status_code == 200:
        assert reply.json() == []
    assert services.audit.verify().problem == ""


def test_no_page_of_ours_keeps_a_secret_where_scripts_of_others_would_find_it(root: Path) -> None:
    """Neither localStorage nor sessionStorage nor a cookie that a script writes, in the pages' own source."""
    for path in (root / "web" / "src").rglob("*"):
        if path.suffix in (".ts", ".svelte") and not path.name.endswith(".test.ts"):
            text = path.read_text()
            assert "document.cookie" not in text, path
            for line in text.splitlines():
                if "localStorage" in line or "sessionStorage" in line:
                    assert not any(word in line.lower() for word in ("password", "csrf", "token", "mark")), (
                        f"{path}: {line}"
                    )


def test_json_of_the_session_is_what_the_pages_read(stranger: TestClient) -> None:
    """The contract's fields, signed in or not."""
    fields = {"signed_in", "name", "role", "permissions", "csrf", "expires", "set_up_needed"}
    assert set(stranger.get("/api/session").json()) == fields
    assert set(json.loads(json.dumps(sign_in(stranger)))) == fields
