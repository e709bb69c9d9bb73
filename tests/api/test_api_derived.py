"""Derived parameters over HTTP: try, add, change, recompute and delete, with the audit log."""

from __future__ import annotations

from fastapi.testclient import TestClient

SUPPLY = {"name": "double_v", "expression": "2 * housekeeping.supply_3v3_v", "unit": "V", "warning": [None, 7.0]}


def test_an_operator_defines_changes_and_deletes_a_parameter(client: TestClient) -> None:
    """The parameter appears among fields and limits at once. The audit log records the old and the new expression."""
    check = client.post("/api/telemetry/derived/check", json={"expression": SUPPLY["expression"]})
    assert check.json() == {
        "kind": "number",
        "references": ["housekeeping.supply_3v3_v"],
        "value": None,
        "reason": "housekeeping.supply_3v3_v has no current value",
    }
    assert client.post("/api/telemetry/derived", json=SUPPLY).status_code == 201
    [parameter] = client.get("/api/telemetry/derived").json()
    assert (parameter["key"], parameter["warning"], parameter["problem"]) == (
        "derived_double_v.double_v",
        [None, 7.0],
        "",
    )
    assert [v["unit"] for v in client.get("/api/telemetry/latest").json()["values"] if v["page"] == "derived"] == ["V"]
    assert parameter["key"] in [f["key"] for f in client.get("/api/telemetry/limits").json()["fields"]]
    changed = SUPPLY | {"expression": "3 * housekeeping.supply_3v3_v"}
    assert client.put("/api/telemetry/derived/double_v", json=changed).json()["expression"] == changed["expression"]
    span = {"start": "2026-11-01T00:00:00Z", "end": "2026-11-02T00:00:00Z"}
    assert client.post("/api/telemetry/derived/double_v/recompute", json=span).status_code == 202
    assert client.delete("/api/telemetry/derived/double_v").status_code == 204
    audit_log = client.get("/api/audit").text
    assert "double_v from 2 * housekeeping.supply_3v3_v to 3 * housekeeping.supply_3v3_v" in audit_log


def test_an_invalid_expression_is_refused_with_its_position(client: TestClient) -> None:
    """The response states the position of the error, or why the result cannot be used."""
    reply = client.post("/api/telemetry/derived", json=SUPPLY | {"expression": "2 * housekeeping.supply_3v3_v )"})
    assert reply.status_code == 400
    assert reply.json()["message"] == "The expression has an error at position 31."
    reply = client.post("/api/telemetry/derived/check", json={"expression": "housekeeping.mode"})
    assert reply.json()["message"] == "The result of the expression is text."
