"""Dictionaries as XTCE: exported documents are read back equal; unsupported elements are rejected with name and line."""

from __future__ import annotations

from functools import lru_cache

import pytest

from gss.device.xtce import xtce, xtce_of
from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import Dictionary
from gss.instruments.dictionary.read_dictionary import load_dictionary, parse_dictionary
from gss.instruments.dictionary.read_xtce import read_xtce
from gss.instruments.package import load_instrument
from gss.instruments.registry import shipped_registry

NOS3 = shipped_registry().get("nos3")
FOREIGN = """<?xml version="1.0"?>
<SpaceSystem name="THERMO" xmlns="http://www.omg.org/spec/XTCE/20180204">
 <TelemetryMetaData>
  <ParameterTypeSet>
   <IntegerParameterType name="U8" signed="false"><IntegerDataEncoding sizeInBits="8"/></IntegerParameterType>
   <FloatParameterType name="Temp"><UnitSet><Unit>°C</Unit></UnitSet>
    <IntegerDataEncoding sizeInBits="16" encoding="twosComplement"><DefaultCalibrator><PolynomialCalibrator>
     <Term coefficient="0.1" exponent="1"/><Term coefficient="-5" exponent="0"/>
    </PolynomialCalibrator></DefaultCalibrator></IntegerDataEncoding>
    <DefaultAlarm><StaticAlarmRanges><WarningRange minInclusive="-20" maxInclusive="60"/></StaticAlarmRanges></DefaultAlarm>
   </FloatParameterType>
  </ParameterTypeSet>
  <ParameterSet>
   <Parameter name="Kind" parameterTypeRef="U8"/>
   <Parameter name="Lens" parameterTypeRef="Temp" shortDescription="Lens"/>
  </ParameterSet>
  <ContainerSet>
   <SequenceContainer name="Header" abstract="true"><EntryList><ParameterRefEntry parameterRef="Kind"/></EntryList>
   </SequenceContainer>
   <SequenceContainer name="State"><EntryList><ParameterRefEntry parameterRef="Lens"/></EntryList>
    <BaseContainer containerRef="Header"><RestrictionCriteria><Comparison parameterRef="Kind" value="7"/></RestrictionCriteria>
    </BaseContainer>
   </SequenceContainer>
  </ContainerSet>
 </TelemetryMetaData>
 <CommandMetaData>
  <ArgumentTypeSet>
   <FloatArgumentType name="Volt"><UnitSet><Unit>V</Unit></UnitSet><FloatDataEncoding sizeInBits="32"/>
    <ValidRangeSet><ValidRange minInclusive="0" maxInclusive="5.5"/></ValidRangeSet></FloatArgumentType>
  </ArgumentTypeSet>
  <MetaCommandSet>
   <MetaCommand name="Any" abstract="true"/>
   <MetaCommand name="HEAT" shortDescription="Heat"><BaseMetaCommand metaCommandRef="Any"><ArgumentAssignmentList>
     <ArgumentAssignment argumentName="opcode" argumentValue="3"/></ArgumentAssignmentList></BaseMetaCommand>
    <ArgumentList><Argument name="level" argumentTypeRef="Volt" initialValue="1.5"/></ArgumentList>
    <DefaultSignificance consequenceLevel="vital" reasonForWarning="Draws power"/>
   </MetaCommand>
  </MetaCommandSet>
 </CommandMetaData>
</SpaceSystem>
"""


LOOP = """<SequenceContainer name="Loop"><EntryList><ParameterRefEntry parameterRef="Kind"/><ContainerRefEntry containerRef="Loop">
<RepeatEntry><Count><DynamicValue><ParameterInstanceRef parameterRef="Kind"/></DynamicValue></Count></RepeatEntry>
</ContainerRefEntry></EntryList></SequenceContainer><SequenceContainer name="State"><EntryList>
<ParameterRefEntry parameterRef="Kind"/><ContainerRefEntry containerRef="Loop"><RepeatEntry><Count><DynamicValue>
<ParameterInstanceRef parameterRef="Kind"/></DynamicValue></Count></RepeatEntry></ContainerRefEntry>"""
MINUTES = """<VerifierSet><AcceptedVerifier><ComparisonList/><CheckWindow timeToStopChecking="PT1M30S"/></AcceptedVerifier>
</VerifierSet></MetaCommand>"""


def ours(facts: str) -> str:
    """Return the ancillary element with data of GSS."""
    return f'<AncillaryDataSet><AncillaryData name="gss">{facts}</AncillaryData></AncillaryDataSet>'


@lru_cache(maxsize=1)
def document() -> str:
    return xtce_of(NOS3)


def read(text: str) -> Dictionary:
    return read_xtce("dictionary.xml", text.encode()).dictionary


@pytest.mark.parametrize(
    ("name", "order"), [("cubestar", "big"), ("nos3", "big"), ("sagitta", "little"), ("oresat", "little")]
)
def test_the_exported_dictionary_is_read_back_equal(name: str, order: str) -> None:
    """Export and import return an equal dictionary and byte order, for each shipped dictionary."""
    instrument = shipped_registry().get(name)
    document_read = read_xtce("dictionary.xml", xtce_of(instrument).encode())
    assert document_read.dictionary == instrument.dictionary
    assert document_read.byte_order == order


def test_repeated_rows_are_read_back_equal() -> None:
    """Lists exported as repeated containers are read back equal, also with a fixed number of rows."""
    sagitta = shipped_registry().get("sagitta")
    assert read(xtce_of(sagitta, repeat_lists=True)) == sagitta.dictionary


def test_an_edited_document_has_another_hash() -> None:
    """An edited document has another hash, because a stated hash applies only to its layout."""
    changed = read(document().replace('label="solved"', 'label="valid"'))
    assert changed.packet("attitude").values[4].choices[1].name == "valid"
    assert changed.hash != NOS3.dictionary.hash
    assert changed.same_layout_as == frozenset()


def test_a_foreign_document_becomes_a_dictionary() -> None:
    """Codes are read from comparisons and assigned arguments. Units, calibrations, alarms, ranges and significance are
    read too."""
    expected = parse_dictionary("""
version: 1
device_model: THERMO
commands:
  - {name: HEAT, code: 3, subsystem: processor, purpose: Heat, hazard: warning, hazard_reason: Draws power, idempotent: false,
     accept_s: 5, complete_s: 30, arguments: [{name: level, type: f32, unit: V, min: 0, max: 5.5, default: 1.5}]}
telemetry:
  - {name: State, code: 7, purpose: State, stale_after_s: 0,
     fields: [{name: Lens, title: Lens, type: i16, unit: °C, conversion: {polynomial: [-5, 0.1]}, warning: [-20, 60]}]}
events: []
services: []
""")
    dictionary = read(FOREIGN)
    assert (dictionary.commands, dictionary.telemetry) == (expected.commands, expected.telemetry)
    assert (dictionary.version, dictionary.device_model) == (1, "THERMO")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</ParameterSet>", "</ParameterSet><StreamSet/>", "line 16: StreamSet: is not supported"),
        (
            '"Lens" parameterTypeRef="Temp"',
            '"Lens" parameterTypeRef="Nothing"',
            "line 15: Parameter name=Lens: unknown type",
        ),
        ('<Term coefficient="0.1" exponent="1"/>', "<SplinePoint/>", "line 8: SplinePoint: is not supported"),
        ("PolynomialCalibrator>", "SplineCalibrator>", "line 7: SplineCalibrator: is not supported"),
        ('sizeInBits="16" encoding="twosComplement"', 'sizeInBits="12"', "line 7: IntegerDataEncoding: this size"),
        ('encoding="twosComplement"', 'encoding="BCD"', "line 7: IntegerDataEncoding: this size or encoding"),
        (
            'minInclusive="-20"',
            'minExclusive="-20"',
            "line 10: WarningRange: the attribute minExclusive is not supported",
        ),
        ("<WarningRange", "<SevereRange", "line 10: SevereRange: is not supported"),
        (
            'parameterRef="Kind" value="7"',
            'parameterRef="Kind" comparisonOperator="&gt;" value="7"',
            "only comparisons with ==",
        ),
        ('parameterRef="Kind" value="7"', 'parameterRef="Kind" value="2357"', "codes must fit in one byte"),
        (
            '<ParameterRefEntry parameterRef="Lens"/>',
            "<ArrayParameterRefEntry/>",
            "ArrayParameterRefEntry: is not supported",
        ),
        ('containerRef="Header"', 'containerRef="Elsewhere"', "has an unknown base"),
        ("</ContainerSet>", "<AggregateContainer/></ContainerSet>", "AggregateContainer: is not supported"),
        (
            'consequenceLevel="vital"',
            'consequenceLevel="forbidden"',
            "DefaultSignificance: this level is not supported",
        ),
        ('argumentValue="3"', 'argumentValue="0x3"', "not an integer"),
        ('minInclusive="0" maxInclusive="5.5"', "", "a number needs min and max"),
        ('initialValue="1.5"', 'initialValue="9"', "default is not allowed"),
        ("<CommandMetaData>", "<SpaceSystem/><CommandMetaData>", "SpaceSystem: is not supported in SpaceSystem"),
        ("org/spec/XTCE/20180204", "org/space/xtce", "line 2: SpaceSystem is not in a supported namespace"),
        ('name="State">', 'name="State">' + ours('{"role_of_container": "headr"}'), "unknown role of a container"),
        (
            '<SequenceContainer name="State">',
            '<SequenceContainer name="Spare">'
            + ours('{"role_of_container": "row"}')
            + "<EntryList/></SequenceContainer>"
            '<SequenceContainer name="State">',
            "SequenceContainer name=Spare: describes rows that no list contains",
        ),
        (
            '<SequenceContainer name="State">',
            '<SequenceContainer name="Done">'
            + ours('{"role_of_container": "returns", "command": "COOL"}')
            + '<EntryList/></SequenceContainer><SequenceContainer name="State">',
            "SequenceContainer name=Done: has the values of an unknown command",
        ),
        ('"Lens"/>\n  </P', '"Lens">' + ours('{"rows": []}') + "</Parameter>\n  </P", "a value has a wrong type"),
        ('<SequenceContainer name="State"><EntryList>', LOOP, "a list inside a list is not supported"),
        ("</MetaCommand>\n  </Meta", f"{MINUTES}\n  </Meta", "timeToStopChecking is not in seconds"),
        ("</SpaceSystem>", "", "not XML"),
        ("<SpaceSystem name", '<!DOCTYPE x [<!ENTITY a "b">]><SpaceSystem name', "document types and entities"),
    ],
)
def test_unsupported_elements_are_rejected_with_name_and_line(old: str, new: str, message: str) -> None:
    """No element is skipped silently, no entity is expanded, and no document is loaded partly."""
    assert old in FOREIGN
    with pytest.raises(BadInput) as error:
        read(FOREIGN.replace(old, new))
    assert message in str(error.value)
    assert "dictionary.xml" in str(error.value)


def test_entries_between_packet_and_header_are_rejected() -> None:
    """A container between header and packet is rejected, because a dictionary contains only the content of packets."""
    middle = (
        '<SequenceContainer name="Time" abstract="true"><EntryList><ParameterRefEntry parameterRef="Kind"/></EntryList>'
    )
    middle += '<BaseContainer containerRef="Header"/></SequenceContainer><SequenceContainer name="State">'
    text = FOREIGN.replace('<SequenceContainer name="State">', middle).replace(
        'containerRef="Header"><Res', 'containerRef="Time"><Res'
    )
    with pytest.raises(BadInput, match="SequenceContainer name=Time: entries between packet and header"):
        read(text)


def test_a_package_may_have_its_dictionary_as_xtce() -> None:
    """A package with dictionary.xml is the same instrument. A byte order that differs from link.yaml and two
    dictionaries are rejected."""
    files = {k: v for k, v in NOS3.files.items() if k != "dictionary.yaml"} | {"dictionary.xml": document().encode()}
    instrument = load_instrument(files)
    assert (instrument.dictionary, instrument.version) == (NOS3.dictionary, NOS3.version)
    little = {**files, "link.yaml": files["link.yaml"].replace(b"byte_order: big", b"byte_order: little")}
    with pytest.raises(BadInput, match="different byte orders"):
        load_instrument(little)
    with pytest.raises(BadInput, match=r"has dictionary\.yaml and dictionary\.xml"):
        load_instrument({**NOS3.files, "dictionary.xml": document().encode()})


def test_names_that_xtce_does_not_allow_are_not_exported() -> None:
    """A name with a dot, which XTCE does not allow, is rejected at export; no invalid document is written."""
    text = "version: 1\ndevice_model: a.b\ncommands: []\ntelemetry: []\nevents: []\nservices: []\n"
    with pytest.raises(BadInput, match="XTCE does not allow this name"):
        xtce(parse_dictionary(text), headers=False)


def test_hazards_of_choices_and_limit_sets_are_kept() -> None:
    """Properties for which XTCE has no element are exported as ancillary data of GSS and are read back."""
    dictionary = load_dictionary()
    text = xtce(dictionary)
    assert read(text).limit_sets == dictionary.limit_sets
    assert '"sets":{"' in text
    assert 'consequenceLevel="critical"' in text
