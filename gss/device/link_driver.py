"""The driver ``link`` implements the protocol that ``link.yaml`` describes. A new sensor therefore needs no code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gss.device.checksum import Calculate, checksum_named
from gss.device.driver import UnitSetup
from gss.device.exchange_session import Answer, ExchangeSession, SensorRequest
from gss.device.link_framing import framer_of
from gss.device.protocol.codec import BIG, LITTLE, STRUCTS, Decoded, EncodedCommand, decode, encode_command, fixed_bytes
from gss.device.session_events import DirectionCounters, Stage
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.definitions import Group, Layout, PacketDefinition, Value
from gss.instruments.link_file import SIZES, HeaderField, PacketFormat, Protocol, check_protocol, is_variable

ORDERS = {"big": BIG, "little": LITTLE}
Header = Mapping[str, int]


def open_session(setup: UnitSetup) -> ExchangeSession:
    """Return the session of the driver ``link``. Raises BadInput if ``link.yaml`` does not fit the dictionary."""
    protocol = setup.link.protocol
    if protocol is None:
        raise BadInput("link.yaml has no protocol", expected="the driver link needs protocol: …", got=setup.instrument)
    wire, by_order = LinkWire(setup, protocol), protocol.match == "order"
    return ExchangeSession(setup, wire, protocol.poll, protocol.pause_s, by_order=by_order)


class LinkWire:
    """A :class:`gss.device.exchange_session.ExchangeWire` composed of the parts that ``link.yaml`` names."""

    def __init__(self, setup: UnitSetup, protocol: Protocol) -> None:
        self._dictionary, self._protocol = setup.dictionary, protocol
        self._order = ORDERS[protocol.byte_order]
        self._payload_order = ORDERS[protocol.payload_byte_order or protocol.byte_order]
        self._framer = framer_of(setup.link, protocol, self._order)
        check = protocol.checksum
        self._calculate: Calculate | None = None
        self._check_bytes, self._check_order = 0, check.byte_order if check else "big"
        if check is not None:
            self._calculate, self._check_bytes = checksum_named(check.name, check.seed)
        check_protocol(setup.link, self._dictionary)
        self._request: SensorRequest | None = None
        self._echo: bytes | None = None
        self.good = self.bad_crc = self.too_short = self.unknown = self.undecodable = 0

    # --- requests -------------------------------------------------------------------------------------------------

    def encode(self, name: str, arguments: Mapping[str, Value]) -> EncodedCommand:
        """Validate and encode a command. Raises BadInput, NotFound."""
        return encode_command(self._dictionary.command(name), arguments, self._payload_order)

    def parts(self, request: SensorRequest) -> list[tuple[str, bytes]]:
        """Return the packet before framing as labelled groups; each argument is a group labelled with its name."""
        form, command = self._protocol.request, request.order.command
        size = form.header_bytes + len(request.order.payload) + self._check_bytes
        codes = form.codes.get(command.name, {})
        groups = []
        for field in form.header:
            code = codes.get(field.name, command.code)
            number = {
                "value": codes.get(field.name, field.value),
                "any": codes.get(field.name, field.value),
                "code": (code & field.mask) | field.value,
                "request_id": request.request_id & field.mask,
                "length": size + field.add,
            }[field.holds]
            groups.append((field.name, _pack(self._order, field, number)))
        groups += request.order.groups
        if self._calculate is not None:
            value = self._calculate(b"".join(data for _, data in groups))
            groups.append(("checksum", value.to_bytes(self._check_bytes, self._check_order)))
        return groups

    def frame(self, request: SensorRequest) -> bytes:
        """Return the frame of a request."""
        return self._framer.encode(b"".join(data for _, data in self.parts(request)))

    def sent(self, request: SensorRequest) -> None:
        """Expect the response to this request. If responses are matched by their order, discard the bytes received
        earlier."""
        self._request = request
        if self._protocol.match == "order":
            self._framer.restart()
        self._echo = b"".join(data for _, data in self.parts(request)) if self._protocol.echo else None

    def restart(self) -> None:
        """Reset the decoder for a newly opened line."""
        self._framer.restart()
        self._request = self._echo = None

    # --- responses ------------------------------------------------------------------------------------------------

    def feed(self, data: bytes) -> list[Answer]:
        """Return the answers in the frames that ``data`` completes."""
        answers = []
        pending = data
        while True:  # read one packet at a time, because the next packet can have another size
            packets = self._framer.feed(pending, self._sizes())
            pending = b""
            for packet in packets:
                answers += self._read(packet)
            if not packets or not self._sizes():
                return answers

    def _sizes(self) -> Sequence[int]:
        """Return the possible sizes of the next packet in bytes; empty if the size is variable."""
        if self._echo is not None:
            return (len(self._echo),)
        overhead = self._protocol.response.header_bytes + self._check_bytes
        if self._request is not None:
            layout = self._layout(self._request)
            return () if is_variable(layout) else (overhead + _size(layout),)
        return tuple(overhead + _size(p.fields) for p in self._dictionary.telemetry if not is_variable(p.fields))

    def _layout(self, request: SensorRequest) -> Layout:
        packet = self._protocol.answers.get(request.order.command.name)
        return self._dictionary.packet(packet).fields if packet else request.order.command.returns

    def _read(self, packet: bytes) -> list[Answer]:
        try:
            if self._echo is not None:
                return self._read_echo(packet)
            return [self._read_response(self._checked(packet))]
        except CorruptData:
            return []

    def _read_echo(self, packet: bytes) -> list[Answer]:
        if packet != self._echo:
            self.unknown += 1
            raise CorruptData("the echo differs from the request")
        self._echo = None
        self.good += 1
        name = self._request.order.command.name if self._request else ""
        done = name not in self._protocol.answers and not self._dictionary.command(name).returns
        if done:
            self._request = None
        return [Answer(Stage.COMPLETED if done else Stage.ACCEPTED)]

    def _checked(self, packet: bytes) -> bytes:
        if len(packet) < self._protocol.response.header_bytes + self._check_bytes:
            self.too_short += 1
            raise CorruptData("too short")
        if self._calculate is None:
            return packet
        body, check = packet[: -self._check_bytes], packet[-self._check_bytes :]
        if self._calculate(body) != int.from_bytes(check, self._check_order):
            self.bad_crc += 1
            raise CorruptData("wrong checksum")
        return body

    def _read_response(self, packet: bytes) -> Answer:
        form = self._protocol.response
        header = _header(self._order, form, packet)
        payload = packet[form.header_bytes :]
        request = self._request
        if request is not None and self._belongs(header, request):
            return self._read_answer(request, header, payload)
        for row in self._dictionary.telemetry:
            if _carries(form, header, row.name, row.code):
                return self._telemetry(row, payload, None)
        self.unknown += 1
        raise CorruptData("no request and no packet has this header")

    def _belongs(self, header: Header, request: SensorRequest) -> bool:
        form, match = self._protocol.response, self._protocol.match
        name = request.order.command.name
        if not _constant(form, header, self._protocol.answers.get(name, name)):
            return False
        if match == "order":
            return True
        field = next(f for f in form.header if f.holds == match)
        expected = request.order.command.code if match == "code" else request.request_id
        compared_bits = field.mask & ((1 << 8 * SIZES[field.type]) - 1)
        return (header[field.name] & compared_bits) == (expected & compared_bits)

    def _read_answer(self, request: SensorRequest, header: Header, payload: bytes) -> Answer:
        accepted, name = self._protocol.accepted, request.order.command.name
        if accepted is not None and (header[accepted.field] & accepted.mask) != accepted.equals:
            self.good += 1
            self._request = None
            reason = f"{accepted.field} {header[accepted.field]:#04x}"
            detail = payload.decode("ascii", "replace").strip("\0 ").replace("\0", "\N{REPLACEMENT CHARACTER}")
            return Answer(Stage.REJECTED, reason=reason, detail=detail)
        packet = self._protocol.answers.get(name)
        if packet:
            answer = self._telemetry(self._dictionary.packet(packet), payload, Stage.COMPLETED)
        else:
            content = self._decoded(request.order.command.returns, payload)
            answer = Answer(Stage.COMPLETED, values=content.values)
            self.good += 1
        self._request = None
        return answer

    def _telemetry(self, row: PacketDefinition, payload: bytes, stage: Stage | None) -> Answer:
        content = self._decoded(row.fields, payload)
        self.good += 1
        return Answer(stage, packet=row.name, content=content)

    def _decoded(self, layout: Layout, payload: bytes) -> Decoded:
        try:
            return decode(layout, payload, self._payload_order)
        except (CorruptData, BadInput) as error:
            self.undecodable += 1
            raise CorruptData(str(error)) from error

    @property
    def received(self) -> DirectionCounters:
        """Counters of the received bytes and packets."""
        framer = self._framer
        return DirectionCounters(
            bytes=framer.bytes,
            good=self.good,
            bad_crc=self.bad_crc + framer.broken,
            too_long=framer.too_long,
            too_short=self.too_short,
            unframed=framer.unframed,
            unknown=self.unknown,
            undecodable=self.undecodable,
        )


def _pack(order: str, field: HeaderField, number: int) -> bytes:
    return STRUCTS[order][field.type].pack(number % (1 << 8 * STRUCTS[order][field.type].size))


def _header(order: str, form: PacketFormat, packet: bytes) -> dict[str, int]:
    fields, at = {}, 0
    for field in form.header:
        number = STRUCTS[order][field.type]
        fields[field.name] = number.unpack_from(packet, at)[0]
        at += number.size
    return fields


def _constant(form: PacketFormat, header: Header, name: str) -> bool:
    """True if the header has the constant values of all packets and of the named packet."""
    codes = form.codes.get(name, {})
    return all(
        (header[f.name] & f.mask) == codes.get(f.name, f.value)
        for f in form.header
        if f.holds == "value" or f.name in codes
    )


def _carries(form: PacketFormat, header: Header, name: str, code: int) -> bool:
    """True if the header identifies an unsolicited packet with this name and code."""
    if not _constant(form, header, name):
        return False
    field = next((f for f in form.header if f.holds == "code"), None)
    return name in form.codes or (field is not None and (header[field.name] & field.mask) == code)


def _size(layout: Layout) -> int:
    """Return the size of a layout without items of variable length, in bytes."""
    lists = [e for e in layout if isinstance(e, Group)]
    return fixed_bytes(layout) + sum(STRUCTS[BIG][e.count].size + e.slots * fixed_bytes(e.items) for e in lists)
