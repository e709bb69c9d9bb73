"""Instruments with their own names and without some operations: services use these names and reject missing
operations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import UTC, datetime

import pytest
from fastapi.testclient import TestClient

from gss.device.session_events import Telemetry
from gss.domain.errors import Conflict
from gss.instruments.dictionary.definitions import Value
from gss.instruments.package_source import read_package_files, write_folder
from gss.instruments.registry import SHIPPED
from gss.operations.line.line_events import LineBatch
from gss.settings import Settings
from gss.wiring.build import build
from gss.wiring.services import Services

SHARED = SHIPPED.parent / "dictionary"
NOW = datetime(2026, 11, 22, 12, tzinfo=UTC)
RENAMED = {
    "name: SCHEDULE\n": "name: RUN_LATER\n",
    "name: payload": "name: content",
    "name: schedule_id": "name: entry",
    "name: at_s": "name: due_s",
    "name: RESET\n": "name: RESTART\n",
    "name: bank_info": "name: store_report",
    "name: active,": "name: in_use,",
}
MAPPED = {
    "  download_frame: {transfer: frame}\n": "",
    "  abort: {command: ABORT}\n": "",
    "{command: SCHEDULE}": "{command: RUN_LATER, arguments: {payload: {name: content}, at_s: {name: due_s}}}",
    "{command: CANCEL}": "{command: CANCEL, arguments: {schedule_id: {name: entry}}}",
    "    schedule_id: schedule_id\n    at_s: at_s\n": "    schedule_id: entry\n    at_s: due_s\n",
    "    payload: payload\n": "    payload: content\n",
    "{command: RESET}": "{command: RESTART}",
    "packet: bank_info": "packet: store_report",
    "    active: active\n": "    active: in_use\n",
}


def replaced(text: str, pairs: dict[str, str]) -> bytes:
    """Return the text with every old text replaced by its new text. Each old text must occur."""
    for old, new in pairs.items():
        assert old in text, old
        text = text.replace(old, new)
    return text.encode()


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    """Services whose instrument has its own dictionary and its own operations.yaml."""
    data = tmp_path_factory.mktemp("mapped")
    files = dict(read_package_files(SHIPPED / "cubestar"))
    manifest = files["instrument.yaml"].decode()
    files["instrument.yaml"] = replaced(manifest, {"id: cubestar": "id: other", "dictionary: gss-common\n": ""})
    files["dictionary.yaml"] = replaced((SHARED / "gss-common.yaml").read_text(), RENAMED)
    files["operations.yaml"] = replaced((SHARED / "gss-common.operations.yaml").read_text(), MAPPED)
    write_folder(data / "instruments" / "other", files)
    services = build(Settings(data=data, instrument="other"))
    yield services
    services.stop()


def batch_of(packet: str, values: dict[str, Value]) -> LineBatch:
    """Return a batch with one telemetry packet."""
    return LineBatch((Telemetry(packet, 1000.0, 0, {}, values),), NOW, 0.0)


def test_a_schedule_uses_the_instrument_s_command_and_arguments(services: Services) -> None:
    """The plan has the mapped argument names and the risk of the scheduled command."""
    plan = services.commanding.schedule.plan("RESTART", {}, at=None, at_device_s=2000.0)
    assert plan.problems == ()
    assert set(plan.order) == {"due_s", "command_code", "length", "content"}
    assert plan.risk.name == "RESTART"
    assert any("restarts unattended" in warning for warning in plan.warnings)
    assert services.commanding.schedule.command() == "RUN_LATER"
    nested = services.commanding.schedule.plan("RUN_LATER", {}, at=None, at_device_s=2000.0)
    assert nested.problems[0] == "schedule commands cannot be scheduled"


def test_a_report_is_read_by_its_mapped_fields(services: Services) -> None:
    """Services read schedule entries and bank reports from the packets of the instrument."""
    values: dict[str, Value] = {"entry": 7, "due_s": 2000.0, "command_code": 3, "length": 0, "content": bytes(64)}
    services.commanding.schedule.handle(batch_of("schedule_entry", values | {"state": "waiting", "reason": "none"}))
    (entry,) = services.commanding.schedule.state().entries
    assert (entry.schedule_id, entry.at_device_s, entry.command) == (7, 2000.0, "RESTART")
    bank: dict[str, Value] = {
        "bank": "B",
        "state": "empty",
        "in_use": False,
        "sha256": bytes(32),
        "stars": 0,
        "pairs": 0,
    }
    services.dispatcher._dispatch(batch_of("store_report", bank))
    assert [view.bank for view in services.transfers.banks.views()] == ["B"]


def test_an_operation_that_is_absent_is_refused_with_its_sentence(services: Services) -> None:
    """Downloads of images and ABORT, which the instrument lacks, are rejected before anything is sent."""
    for kind in ("frame", "thumbnail"):
        with pytest.raises(Conflict) as caught:
            services.frames.downloads.start(kind, slot=0)
        assert caught.value.message == "This sensor cannot download images."
    with pytest.raises(Conflict, match="the line is down"):
        services.frames.downloads.start("star_windows", slot=0)
    with pytest.raises(Conflict) as caught:
        services.commanding.commands.abort(user="anna", source="abort")
    assert caught.value.message == "This sensor has no command to abort."


def test_the_dictionary_lists_what_the_sensor_has(services: Services, client_of: Callable[..., TestClient]) -> None:
    """The dictionary lists the operations with their commands, the missing operations with a sentence, and the
    quantities.
    """
    with client_of(services) as client:
        roles = client.get("/api/dictionary").json()["roles"]
    assert roles["operations"]["schedule"] == "RUN_LATER"
    assert roles["operations"]["download_window"] == ""
    assert roles["absent"]["download_frame"] == "This sensor cannot download images."
    assert "download_frame" not in roles["operations"]
    assert "status.mode" in roles["quantities"]
