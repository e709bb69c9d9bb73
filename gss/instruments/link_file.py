"""``link.yaml``: settings of the line of a unit. For the driver ``link``, the file also describes the protocol of the
sensor."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from gss.domain.errors import BadInput, NotFound
from gss.instruments.dictionary.definitions import Dictionary, Item, Layout
from gss.instruments.quantities import Noted, Strict

Positive = Annotated[float, Field(gt=0, le=1e12)]
ByteOrder = Literal["big", "little"]
ShortName = Annotated[str, Field(min_length=1, max_length=60)]
Whole = Annotated[int, Field(ge=0, le=0xFFFF_FFFF)]
HexBytes = Annotated[str, Field(pattern=r"^[0-9A-Fa-f]{2}( ?[0-9A-Fa-f]{2}){0,7}$")]
VARIABLE = ("text", "rest")
SIZES = {"u8": 1, "u16": 2, "u32": 4}


class HeaderField(Strict):
    """One number of a header. ``holds`` selects its content:

    - ``value``: the constant ``value``, in requests and responses.
    - ``code``: the code of the command or telemetry packet.
    - ``request_id``: the number of the request, assigned by the ground.
    - ``length``: the number of bytes from the start of the header to the end of the packet, plus ``add``.
    - ``any``: any content in a response; in a request, the constant ``value``.

    A code can share its field with other bits. ``mask`` selects the bits of the code. ``value`` sets the other bits of a
    request; in a response, they are not compared.
    """

    name: ShortName
    type: Literal["u8", "u16", "u32"]
    holds: Literal["value", "code", "request_id", "length", "any"] = "value"
    value: Whole = 0
    mask: Whole = 0xFFFF_FFFF
    add: Annotated[int, Field(ge=-0xFFFF, le=0xFFFF)] = 0


class Acceptance(Strict):
    """Condition for an accepted request: in the response, the bits ``mask`` of the header field ``field`` equal
    ``equals``. Any other response rejects the request."""

    field: ShortName
    mask: Whole
    equals: Whole


class Checksum(Strict):
    """Checksum after the payload, over all bytes from the start of the header. ``name``: name in the catalogue of
    parametrised CRC algorithms, for example CRC-16/MCRF4XX, or XXH32."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    byte_order: ByteOrder = "big"
    seed: Whole = 0


class Poll(Strict):
    """A command that the ground repeats at an interval, because the sensor sends data only on request."""

    command: ShortName
    every_s: Positive


class PacketFormat(Strict):
    """Header of the packets in one direction. The fields are in the order of transmission. ``codes``: values of header
    fields by command or packet, if more than one field identifies a command or packet."""

    header: Annotated[tuple[HeaderField, ...], Field(max_length=20)] = ()
    codes: dict[ShortName, dict[ShortName, Whole]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [field.name for field in self.header]
        if len(set(names)) < len(names):
            raise ValueError("header: a name appears twice")
        for content in ("code", "request_id", "length"):
            if sum(field.holds == content for field in self.header) > 1:
                raise ValueError(f"header: more than one field holds the {content}")
        for row in self.codes.values():
            if not set(row) <= set(names):
                raise ValueError(f"codes: no header field is named {', '.join(sorted(set(row) - set(names)))}")
        return self

    @property
    def header_bytes(self) -> int:
        """Size of the header in bytes."""
        return sum(SIZES[field.type] for field in self.header)

    def offset(self, name: str) -> int:
        """Return the byte offset of a field. Raises StopIteration for an unknown field."""
        at = next(k for k, field in enumerate(self.header) if field.name == name)
        return sum(SIZES[field.type] for field in self.header[:at])


class Protocol(Strict):
    """Format of the requests and responses of a sensor with the driver ``link``.

    ``match``: how a response is assigned to its request: by order (``order``), by code (``code``) or by request number
    (``request_id``). ``echo``: True if the sensor first returns each request unchanged. ``answers``: name of the
    telemetry packet in the response, for each command with such a response. Other responses contain the return values
    of the command. ``payload_byte_order``: byte order of the payload, if different from the header. ``pause_s``: pause
    between an exchange and the next request.
    """

    byte_order: ByteOrder = "big"
    payload_byte_order: ByteOrder | None = None
    sync: HexBytes | None = None
    trailer: HexBytes | None = None
    checksum: Checksum | None = None
    request: PacketFormat
    response: PacketFormat = PacketFormat()
    match: Literal["order", "code", "request_id"] = "order"
    echo: bool = False
    accepted: Acceptance | None = None
    answers: dict[ShortName, ShortName] = Field(default_factory=dict)
    poll: Annotated[tuple[Poll, ...], Field(max_length=20)] = ()
    pause_s: Annotated[float, Field(ge=0, le=60)] = 0.0

    @model_validator(mode="after")
    def _matched(self) -> Self:
        contents = {field.holds for field in self.response.header}
        if self.match != "order" and self.match not in contents:
            raise ValueError(f"match: no field of the response's header holds the {self.match}")
        if self.accepted is not None and self.accepted.field not in {f.name for f in self.response.header}:
            raise ValueError(f"accepted: the response's header has no field {self.accepted.field}")
        return self


class LinkFile(Noted):
    """``link.yaml``: settings of the line of the unit. ``baud``: rate of the line; 0: default rate of a serial port,
    and a simulated line without a rate limit. ``hello_again_s``: pause between attempts to open the session.
    ``stalled_after_s``: a line that accepts no bytes for this time is closed and opened again. ``protocol``: only for
    the driver ``link``. ``byte_order``: byte order of the numbers in the packets of other drivers; only exports use
    it."""

    framing: Literal["cobs", "slip", "kiss", "length_prefixed", "sync_and_trailer", "can", "none"] = "cobs"
    baud: Annotated[int, Field(ge=0, le=100_000_000)] = 115_200
    hello_again_s: Positive = 3.0
    stalled_after_s: Positive = 20.0
    protocol: Protocol | None = None
    byte_order: ByteOrder | None = None

    @property
    def content_byte_order(self) -> str | None:
        """Return the byte order of the numbers in the packets; None if only the driver defines it."""
        if self.protocol is None:
            return self.byte_order
        return self.protocol.payload_byte_order or self.protocol.byte_order

    @field_validator("protocol")
    @classmethod
    def _has_requests(cls, protocol: Protocol | None) -> Protocol | None:
        if protocol is not None and not protocol.request.header:
            raise ValueError("request: the header is empty")
        return protocol

    @model_validator(mode="after")
    def _delimited(self) -> Self:
        if self.protocol is None:
            return self
        if self.byte_order is not None:
            raise ValueError("byte_order is for drivers without a protocol; use protocol.payload_byte_order")
        protocol = self.protocol
        if self.framing == "sync_and_trailer" and (protocol.sync is None or protocol.trailer is None):
            raise ValueError("framing sync_and_trailer needs protocol.sync and protocol.trailer")
        if self.framing == "length_prefixed" and not any(f.holds == "length" for f in protocol.response.header):
            raise ValueError("framing length_prefixed needs a length in the response's header")
        return self


def is_variable(layout: Layout) -> bool:
    """True if the size of a layout depends on its content."""
    return any(e.type in VARIABLE if isinstance(e, Item) else not e.slots for e in layout)


def check_protocol(link: LinkFile, dictionary: Dictionary) -> None:
    """Raise BadInput if the protocol names a command or packet that the dictionary does not have, or if the framing cannot
    delimit a packet of the dictionary."""
    protocol = link.protocol
    if protocol is None:
        return
    try:
        for command, packet in protocol.answers.items():
            dictionary.command(command)
            dictionary.packet(packet)
        for row in protocol.poll:
            dictionary.command(row.command)
        for command in protocol.request.codes:
            dictionary.command(command)
    except NotFound as error:
        raise BadInput(f"link.yaml: {error.message}", expected=error.expected, got=error.got) from error
    if link.framing not in ("sync_and_trailer", "none") or (protocol.sync is None and protocol.trailer is None):
        return
    layouts = {c.name: c.returns for c in dictionary.commands if c.name not in protocol.answers}
    for name, layout in (layouts | {p.name: p.fields for p in dictionary.telemetry}).items():
        if is_variable(layout):
            raise BadInput(
                f"link.yaml: the framing {link.framing} needs packets of fixed size",
                expected="values of fixed size, or the framing length_prefixed",
                got=f"{name} of variable size",
            )
