"""Standard operations and quantities: mapped to an instrument's own names, checked against its dictionary."""

from __future__ import annotations

import pytest

from gss.domain.errors import BadInput, Conflict
from gss.instruments.dictionary.read_dictionary import load_dictionary, read_dictionary
from gss.instruments.marked_yaml import parse_yaml
from gss.instruments.operations import Operation
from gss.instruments.package import load_instrument
from gss.instruments.package_source import read_package_files
from gss.instruments.registry import SHIPPED, shipped_registry
from gss.instruments.roles import SHARED, Roles, default_roles, read_roles
from gss.operations.accounts.permissions import GROUPS

CUBESTAR = read_package_files(SHIPPED / "cubestar")


def roles_of(text: str) -> Roles:
    """Return the roles in a text, for the shared dictionary."""
    return read_roles(parse_yaml("operations.yaml", text.encode()), load_dictionary())


def test_every_operation_of_the_shared_protocol_is_mapped() -> None:
    """Every instrument with the shared dictionary has all standard operations, and uses the shared file."""
    shared = default_roles(load_dictionary())
    assert set(shared.operations.names()) == set(Operation)
    for instrument in (i for i in shipped_registry().all() if i.about.dictionary == SHARED):
        assert set(instrument.roles.operations.names()) == set(Operation)
        assert instrument.roles.quantities == shared.quantities
        assert "operations.yaml" not in instrument.files


def test_every_command_is_in_a_subsystem_that_has_a_permission() -> None:
    """Each command belongs to a subsystem with a permission; otherwise only administrators could send it."""
    for instrument in shipped_registry().all():
        assert {c.subsystem for c in instrument.dictionary.commands} <= set(GROUPS), instrument.name


@pytest.mark.parametrize(
    ("text", "place", "reason"),
    [
        ("operations:\n  hello: {command: HULLO}\n", "line 2: operations.hello.command", "no command HULLO"),
        ("operations:\n  hullo: {command: HELLO}\n", "line 2: operations.hullo", "Input should be"),
        ("operations:\n  hello: {}\n", "line 2: operations.hello", "needs either a command"),
        ("operations:\n  hello: {transfer: frame}\n", "line 2: operations.hello", "needs a command"),
        (
            "operations:\n  take_image:\n    command: TAKE_IMAGE\n    arguments: {slot: {name: place}}\n",
            "line 4: operations.take_image.arguments.slot",
            "TAKE_IMAGE has no argument place",
        ),
        (
            "operations:\n  stop_cycle: {command: SET_MODE, fixed: {mode: idle}}\n",
            "line 2: operations.stop_cycle.fixed.mode",
            "mode has no such choice; expected standby |",
        ),
        (
            "operations:\n  take_image: {command: TAKE_IMAGE, fixed: {exposure_ms: 9999}}\n",
            "line 2: operations.take_image.fixed.exposure_ms",
            "9999",
        ),
        (
            "operations:\n  take_image: {command: TAKE_IMAGE, arguments: {gain: {name: slot}}}\n",
            "line 2: operations.take_image.arguments.gain",
            "it has slot, exposure_s",
        ),
        (
            "quantities:\n  bank:\n    packet: attitude\n    state: mode\n",
            "line 4: quantities.bank.state",
            "the choice lost_in_space of mode has more than 12 characters",
        ),
        ("quantities:\n  status: {packet: state}\n", "line 2: quantities.status.packet", "no packet state"),
        ("quantities:\n  status: {mode: mode}\n", "line 2: quantities.status.packet", "no packet (empty)"),
        (
            "quantities:\n  status:\n    packet: housekeeping\n    mode: state\n",
            "line 4: quantities.status.mode",
            "housekeeping has no field state",
        ),
        (
            "quantities:\n  status:\n    packet: housekeeping\n    exposure_ms: uptime_s\n",
            "line 4: quantities.status.exposure_ms",
            "uptime_s is in s, not ms",
        ),
        (
            "quantities:\n  attitude:\n    packet: attitude\n    quaternion: [quaternion_w, q, quaternion_y, quaternion_z]\n",
            "line 4: quantities.attitude.quaternion",
            "attitude has no field q",
        ),
        ("events:\n  boot: START\n", "line 2: events.boot", "no event START"),
    ],
)
def test_a_wrong_name_is_rejected_with_line_field_and_reason(text: str, place: str, reason: str) -> None:
    """An unknown command, argument, packet, field or event is rejected with its line, field and reason."""
    with pytest.raises(BadInput) as caught:
        roles_of(text)
    assert f"operations.yaml, {place}" in str(caught.value)
    assert reason in str(caught.value)


def test_operations_of_a_package_are_checked_and_replace_the_shared_ones() -> None:
    """A package's operations.yaml is checked when the package is read, and replaces the shared file."""
    with pytest.raises(BadInput, match=r"operations\.yaml, line 1"):
        load_instrument({**CUBESTAR, "operations.yaml": b"operations: {hello: {command: HULLO}}\n"})
    instrument = load_instrument({**CUBESTAR, "operations.yaml": b"operations: {hello: {command: HELLO}}\n"})
    assert instrument.roles.operations.names() == (Operation.HELLO,)
    assert instrument.version != load_instrument(CUBESTAR).version


def test_arguments_are_renamed_and_converted_both_ways() -> None:
    """Standard arguments are converted to the command's arguments, in its unit and type, and back."""
    text = (
        "operations:\n  take_image: {command: TAKE_IMAGE, arguments: {exposure_s: {name: exposure_ms, scale: 1000}}}\n"
    )
    operations = roles_of(text).operations
    call = operations.call(Operation.TAKE_IMAGE, {"slot": 2, "exposure_s": 0.25})
    assert call.command == "TAKE_IMAGE"
    assert call.arguments == {"slot": 2, "exposure_ms": 250}
    assert isinstance(call.arguments["exposure_ms"], int)
    assert operations.given(Operation.TAKE_IMAGE, call.arguments) == {"slot": 2, "exposure_s": 0.25}


def test_fixed_arguments_are_added() -> None:
    """An operation can be mapped to a command with a fixed argument, which is added to each call."""
    roles = roles_of("operations: {stop_cycle: {command: SET_MODE, fixed: {mode: standby}}}\n")
    assert roles.operations.call(Operation.STOP_CYCLE).arguments == {"mode": "standby"}


@pytest.mark.parametrize(
    ("operation", "sentence"),
    [
        (Operation.DOWNLOAD_FRAME, "This sensor cannot download images."),
        (Operation.SET_TIME, "This sensor has no command to set time."),
    ],
)
def test_an_absent_operation_is_rejected_with_one_sentence(operation: Operation, sentence: str) -> None:
    """An operation that the instrument lacks is rejected with a sentence for the operator."""
    with pytest.raises(Conflict) as caught:
        roles_of("operations: {hello: {command: HELLO}}\n").operations.require(operation)
    assert caught.value.message == sentence


def test_a_quaternion_is_read_in_its_order_and_sense() -> None:
    """A quaternion with another order and direction is converted to scalar-last and ICRS to camera."""
    head = "quantities:\n  attitude:\n    packet: attitude\n"
    head += "    quaternion: [quaternion_w, quaternion_x, quaternion_y, quaternion_z]\n"
    attitude = roles_of(head + "    order: scalar_first\n    rotation: icrs_from_cam\n").quantities.attitude
    values = {"quaternion_w": 0.5, "quaternion_x": 0.1, "quaternion_y": 0.2, "quaternion_z": 0.3}
    assert attitude.quaternion_of(values) == (-0.1, -0.2, -0.3, 0.5)


def test_a_separate_dictionary_keeps_the_operations_it_shares() -> None:
    """A dictionary that lacks one command of the shared protocol lacks only that operation."""
    text = (SHIPPED.parent / "dictionary" / "gss-common.yaml").read_text()
    dictionary = read_dictionary("dictionary.yaml", text.replace("name: TAKE_IMAGE", "name: EXPOSE").encode())
    assert set(Operation) - set(default_roles(dictionary).operations.names()) == {Operation.TAKE_IMAGE}


def test_a_shared_command_is_the_operation_of_its_arguments() -> None:
    """A command of several operations is the one with most fixed arguments of which all fit, with defaults and numbers of
    choices, or none."""
    operations = roles_of(
        "operations:\n"
        "  set_exposure: {command: TAKE_IMAGE}\n"
        "  take_image: {command: TAKE_IMAGE, fixed: {slot: 1}}\n"
        "  abort: {command: TAKE_IMAGE, fixed: {slot: 1, exposure_ms: 0}}\n"
        "  erase: {command: ERASE_BANK, fixed: {bank: A}}\n"
    ).operations
    assert operations.of_command("TAKE_IMAGE", {"slot": 1, "exposure_ms": 0}) is Operation.ABORT
    assert operations.of_command("TAKE_IMAGE", {"slot": 1}) is Operation.ABORT
    assert operations.of_command("TAKE_IMAGE", {"slot": 1, "exposure_ms": 5}) is Operation.TAKE_IMAGE
    assert operations.of_command("TAKE_IMAGE", {"slot": 0, "exposure_ms": 0}) is Operation.SET_EXPOSURE
    number = operations.dictionary.command("ERASE_BANK").argument("bank").choice("A").value
    assert operations.of_command("ERASE_BANK", {"bank": number}) is Operation.ERASE
    assert operations.of_command("ERASE_BANK", {"bank": "B"}) is None
    assert operations.of_command("ERASE_BANK", {}) is None
    assert operations.of_command("HELLO", {}) is None
