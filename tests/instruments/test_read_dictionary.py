"""The dictionary is checked when it is read."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest
import yaml

from gss.device.icd import icd_markdown
from gss.domain.errors import BadInput, NotFound
from gss.instruments.dictionary.definitions import Conversion, Hazard, Precondition
from gss.instruments.dictionary.read_dictionary import load_dictionary, parse_dictionary

TEXT = resources.files("gss.instruments.dictionary").joinpath("gss-common.yaml").read_text("utf-8")


def test_interface_document_is_up_to_date() -> None:
    """docs/icd.md is equal to the document generated from the dictionary. ``gss export icd --out docs/icd.md`` updates it."""
    path = Path(__file__).parents[2] / "docs" / "icd.md"
    assert path.read_text("utf-8") == icd_markdown(load_dictionary())


LAYOUT = "2e7c65aed5a7e178eda5a59060a453c1676c4bd745e8b3105208004f0b840850"
"""Hash of the layout to which the hashes in ``same_layout_as`` are equal."""


def test_a_changed_layout_does_not_claim_to_be_an_earlier_one() -> None:
    """A dictionary with a changed layout has an empty ``same_layout_as``.

    If this fails after you changed a field, range or code: empty ``same_layout_as``, increase ``version``, and enter the
    new hash above. Otherwise a unit with the earlier layout would be decoded with the new one."""
    dictionary = load_dictionary()
    assert dictionary.hash.hex() == LAYOUT or not dictionary.same_layout_as, dictionary.hash.hex()


def test_hash_depends_on_the_layout_and_not_on_order_or_descriptions() -> None:
    """A comment, another order of keys or another description does not change the hash; another timeout does."""
    content = yaml.safe_load(TEXT)
    assert parse_dictionary(yaml.safe_dump(content)).hash == load_dictionary().hash
    assert parse_dictionary(TEXT + "# remark\n").hash == load_dictionary().hash
    content["commands"][0]["purpose"] += "!"
    assert parse_dictionary(yaml.safe_dump(content)).hash == load_dictionary().hash
    content["commands"][0]["accept_s"] += 1.0
    assert parse_dictionary(yaml.safe_dump(content)).hash != load_dictionary().hash


def test_names_that_equal_a_description_key_are_part_of_the_layout() -> None:
    """The hash depends on an enumeration and on a limit set whose names are also keys of descriptions."""
    hashes = set()
    for enum, limits in (([0, 1], 1), ([1, 0], 1), ([0, 1], 2)):
        content = yaml.safe_load(TEXT)
        content["enums"]["action"] = [{"name": name, "value": value} for name, value in zip("ab", enum, strict=True)]
        content["limit_sets"] = [*content.get("limit_sets", ()), {"name": "page"}]
        content["telemetry"][0]["fields"][0]["sets"] = {"page": {"watch": [0, limits]}}
        hashes.add(parse_dictionary(yaml.safe_dump(content)).hash)
    assert len(hashes) == 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("code: 2\n    subsystem", "code: 1\n    subsystem", "appears twice"),
        ("name: GET_STATUS", "name: HELLO", "appears twice"),
        ("name: GET_STATUS", f"name: {'G' * 61}", "the name is too long; expected at most 60 characters; got 61"),
        ("name: housekeeping\n", f"name: {'h' * 41}\n", "expected at most 40 characters; got 41"),
        ("name: uptime_s,", f"name: {'u' * 41},", "the name is too long; expected at most 53 characters; got 54"),
        ("limit_sets:\n", f"limit_sets:\n  - {{name: {'s' * 31}}}\n", "expected at most 30 characters; got 31"),
        ("min: 1, max: 2000, default: 250", "min: 1, max: 2000, default: 2250", "default is not allowed"),
        ("min: 1, max: 2000, default: 250", "min: 1, max: 70000, default: 250", "does not fit u16"),
        ("type: u16, unit: ms, min: 1, max: 2000,", "type: u12, unit: ms, min: 1, max: 2000,", "unknown type"),
        ("enum: mode, default: lost_in_space", "enum: modes, default: lost_in_space", "enum is missing or unknown"),
        ("enum: mode, default: lost_in_space", "enum: mode, default: lost", "default is not allowed"),
        ("{linear: [0.0625, -50.0]}", "{eval: [0.0625, -50.0]}", "unknown conversion"),
        ("{field: mode, op: ne,", "{field: mood, op: ne,", "unknown field"),
        ("{field: mode, op: ne,", "{field: mode, op: is,", "unknown operator"),
        ("op: ne, value: standby", "op: ne, value: idle", "mode cannot have this value; expected standby |"),
        ("idempotent: true", "idempotent: yes", "idempotent is not a boolean; expected true or false; got 'yes'"),
        ("accept_s: 1.0", "accept_s: .nan", "accept_s: not a finite number; got nan"),
        ("accept_s: 1.0", "accept_s: 0", "accept_s is not above 0"),
        ("min: 1, max: 2000,", 'min: "1", max: 2000,', "min: not a finite number; got '1'"),
        ("watch: [-15, 45]", "watch: [-15 °C, 45 °C]", "not a finite number; got '-15 °C'"),
        ("{linear: [0.0625, -50.0]}", "{linear: [0.0625, .inf]}", "not a finite number; got inf"),
        ("hazard_reason: The bank's", "hazard_reasoning: The bank's", "unknown keys"),
        ("watch: [-15, 45]", "watch: [45, -15]", "the lower limit is above the upper limit"),
        ("{watch: [null, 60.0]}", "{watches: [null, 60.0]}", "unknown keys"),
        ("sets: {commissioning: {watch: [null, 60.0]}}", "sets: {training: {}}", "unknown limit set"),
        ("critical: [-30, 65], persistence: 3", "critical: [-10, 65], persistence: 3", "beyond a more urgent level"),
        ("persistence: 3,", "persistence: 0,", "persistence is out of range"),
        ("limit_sets:", "limit_set:", "unknown keys"),
        ("commands:", "commands: [", "not YAML"),
        (
            'purpose: "Counter of sent chunks, repeats included"',
            "purpose: Counter of sent chunks, repeats included",
            "unknown keys",
        ),
        ("{name: serial, type: str16}", "{name: serial, type: str16, length: 16}", "unknown keys"),
    ],
)
def test_an_invalid_row_is_rejected_with_the_reason(old: str, new: str, message: str) -> None:
    """A dictionary with an error of any kind is rejected when it is loaded, with the reason."""
    assert old in TEXT
    with pytest.raises(BadInput) as caught:
        parse_dictionary(TEXT.replace(old, new, 1))
    assert message in str(caught.value)


def test_hazardous_commands_are_marked() -> None:
    """Commands that can lose a catalogue or the session are marked."""
    d = load_dictionary()
    hazards = {c.name: c.hazard for c in d.commands if c.hazard is not Hazard.NONE}
    assert hazards == {
        "RESET": Hazard.WARNING,
        "CLEAR_LATCHUP": Hazard.WARNING,
        "SCHEDULE": Hazard.WATCH,
        "ACTIVATE_BANK": Hazard.CRITICAL,
        "ROLLBACK_BANK": Hazard.WARNING,
        "ERASE_BANK": Hazard.CRITICAL,
        "ACTIVATE_TABLE": Hazard.CRITICAL,
        "ROLLBACK_TABLE": Hazard.WARNING,
        "ERASE_TABLE": Hazard.CRITICAL,
    }
    once = [name for name in hazards if name != "CLEAR_LATCHUP"]
    assert not any(d.command(name).idempotent for name in ("TAKE_IMAGE", "RUN_ITERATION", *once))


def test_a_value_of_an_enumeration_can_be_the_hazard() -> None:
    """POWER has no hazard when it switches on, and a warning with a reason when it switches off."""
    d = load_dictionary()
    power = d.command("POWER")
    assert power.hazard_for({"rail": "sram", "state": "on"}) == (Hazard.NONE, "")
    assert power.hazard_for({"rail": "sram", "state": "off"}) == (Hazard.WARNING, "The unit loses its stored content")
    assert power.hazard_for({"state": 0})[0] is Hazard.WARNING
    assert power.hazard_for({})[0] is Hazard.NONE
    activate = d.command("ACTIVATE_BANK")
    assert activate.hazard_for({"bank": "B"}) == (Hazard.CRITICAL, activate.hazard_reason)


def test_limits_follow_the_chosen_set() -> None:
    """A field has limits for a set only if its row states them. Persistence is 1 unless stated."""
    d = load_dictionary()
    fields = {f.name: f for f in d.packet("housekeeping").values}
    warm, rate = fields["sensor_temperature_c"], fields["rate_deg_s"]
    assert [s.name for s in d.limit_sets] == ["nominal", "commissioning"]
    assert (warm.limits.watch, warm.persistence) == ((-15, 45), 3)
    assert "nominal" not in warm.sets
    assert warm.sets["commissioning"].watch == (-25, 55)
    assert "commissioning" not in rate.sets
    assert rate.persistence == 1


def test_only_a_simulator_has_the_instructors_commands() -> None:
    """The commands marked as simulator-only are exactly those whose name starts with ``SIM_``."""
    assert {c.name for c in load_dictionary().commands if c.simulator_only} == {
        c.name for c in load_dictionary().commands if c.name.startswith("SIM_")
    }


def test_unknown_names_list_the_known_ones() -> None:
    """Look-up of an unknown name raises an error with the known names. Look-up of an unknown code returns None."""
    d = load_dictionary()
    with pytest.raises(NotFound, match="TAKE_IMAGE"):
        d.command("TAKE_PICTURE")
    with pytest.raises(NotFound, match="housekeeping"):
        d.packet("x")
    assert d.command_of_code(250) is None
    assert d.packet_of_code(250) is None
    assert d.event_of_code(250) is None
    assert d.service_of_code("transfer", 250) is None


def test_conversion_is_the_polynomial() -> None:
    """Raw values are converted with the polynomial. Values without coefficients and text are returned unchanged."""
    assert Conversion((2.0, 3.0, 0.5)).engineering(4) == pytest.approx(2 + 12 + 8)
    assert Conversion().engineering(4) == 4
    assert Conversion((1.0, 1.0)).engineering("text") == "text"


@pytest.mark.parametrize(
    ("op", "value", "left", "met"),
    [
        ("eq", 1, 1, True),
        ("ne", "standby", "standby", False),
        ("lt", 3, 2, True),
        ("le", 3, 4, False),
        ("gt", 3, 4, True),
        ("ge", 5, 4, False),
    ],
)
def test_preconditions_compare(op: str, value: int | str, left: int | str, met: bool) -> None:
    """Each operator compares the field with the value. The result is None if the field is unknown."""
    condition = Precondition("f", op, value, "")
    assert condition.met({"f": left}) is met
    assert condition.met({}) is None
    assert condition.met(None) is None
