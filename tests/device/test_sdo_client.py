"""Service data objects: the client with the library ``canopen`` in both directions, and with damaged transfers."""

from __future__ import annotations

from collections.abc import Callable

import canopen.network
import pytest
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary import datatypes as dt
from canopen.sdo import SdoClient as LibraryClient
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.device.sdo_client import NUDGES, TIMED_OUT, WRONG_CRC, SdoClient, SdoResult
from gss.device.simulator.sdo_blocks import BlockServer

INDEX = 0x4001
Server = Callable[[bytes], list[bytes]]


class MemoryNetwork(canopen.network.Network):
    """The library's network without a bus. Each sent message is passed to ``deliver``."""

    def __init__(self, deliver: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._deliver = deliver

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._deliver(can_id, bytes(data))


def library_server(content: bytes, written: list[bytes]) -> Server:
    """Return the library's server with one object."""
    dictionary = canopen.ObjectDictionary()
    variable = ODVariable("content", INDEX, 0)
    variable.data_type, variable.access_type = dt.DOMAIN, "rw"
    dictionary.add_object(variable)
    out: list[bytes] = []
    network = MemoryNetwork(lambda _, data: out.append(data))
    node = network.create_node(0x2C, dictionary)
    node.add_read_callback(lambda **_: content)
    node.add_write_callback(lambda data, **_: written.append(bytes(data)))

    def serve(message: bytes) -> list[bytes]:
        out.clear()
        network.notify(0x62C, bytearray(message), 0.0)
        return list(out)

    return serve


def run(client: SdoClient, first: bytes, server: Server, lose: set[int] | None = None) -> SdoResult:
    """Exchange messages until there is a result. Responses with the numbers in ``lose`` are dropped once."""
    lost, count, messages = set(lose or ()), 0, [first]
    for _ in range(100_000):
        answers = server(messages.pop(0)) if messages else []
        for answer in answers:
            count += 1
            if count in lost:
                continue
            reply = client.feed(answer)
            messages += [reply] if reply else []
        if client.result is not None:
            assert not client.busy
            return client.result
        if not messages:
            messages.append(client.nudge())
    raise AssertionError("no result")


@settings(deadline=None, max_examples=40)
@given(st.binary(min_size=1, max_size=400), st.booleans())
def test_objects_are_read_from_the_library_and_written_to_it(data: bytes, block: bool) -> None:
    """Objects of every size are read from the library's server and written to it, also if it answers a block request with
    a segmented transfer."""
    written: list[bytes] = []
    server, client = library_server(data, written), SdoClient()
    assert run(client, client.start_read(INDEX, 0, block=block), server).data == data
    assert run(client, client.start_write(INDEX, 0, data), server).abort == 0
    assert written == [data]


@pytest.mark.parametrize("size", [1, 7, 8, 889, 890, 3000])
def test_blocks_are_read_by_the_library_too(size: int) -> None:
    """The library's client and ours both read blocks from the simulated server."""
    content = bytes(k * 7 % 251 for k in range(size))
    server = BlockServer(lambda *_: content)
    client = SdoClient()
    assert run(client, client.start_read(INDEX, 5, block=True), server.respond).data == content

    def deliver(can_id: int, data: bytes) -> None:
        for answer in server.respond(data):
            library.on_response(0x5AC, bytearray(answer), 0.0)

    library = LibraryClient(0x62C, 0x5AC, canopen.ObjectDictionary())
    library.network = MemoryNetwork(deliver)
    with library.open(INDEX, 5, "rb", block_transfer=True) as file:
        assert file.read() == content


@settings(deadline=None, max_examples=60)
@given(st.integers(900, 4000), st.sets(st.integers(2, 600), max_size=12))
def test_lost_segments_of_a_block_are_repeated(size: int, lose: set[int]) -> None:
    """With lost segments the content is read unchanged, or the transfer fails. Damaged content is never returned."""
    content = bytes(k * 11 % 253 for k in range(size))
    client = SdoClient()
    result = run(client, client.start_read(INDEX, 5, block=True), BlockServer(lambda *_: content).respond, lose)
    assert result.data == content if not result.abort else result.data == b""


def test_a_transfer_succeeds_despite_one_lost_segment() -> None:
    """A transfer succeeds if a segment within a block, the last of a block or the last of all is lost."""
    content = bytes(range(256)) * 8
    for lost_segment in (40, 127, -(-len(content) // 7)):
        client = SdoClient()
        server = BlockServer(lambda *_: content).respond
        assert run(client, client.start_read(INDEX, 5, block=True), server, {lost_segment + 1}).data == content


def test_damaged_content_is_rejected_by_its_checksum() -> None:
    """A transfer with a changed byte fails with a checksum error."""
    server = BlockServer(lambda *_: bytes(100)).respond

    def damaging(message: bytes) -> list[bytes]:
        return [a[:3] + b"\7" + a[4:] if a[0] == 5 else a for a in server(message)]

    client = SdoClient()
    assert run(client, client.start_read(INDEX, 5, block=True), damaging).abort == WRONG_CRC


def test_an_interrupted_transfer_ends_with_a_reason() -> None:
    """The client repeats its request to a silent server ``NUDGES`` times, then aborts with the reason."""
    client, server = SdoClient(), BlockServer(lambda *_: bytes(2000)).respond
    answer = client.feed(server(client.start_read(INDEX, 5, block=True))[0])
    for segment in server(answer)[:50]:
        client.feed(segment)
    requests = [client.nudge() for _ in range(NUDGES)]
    assert requests[0][:3] == bytes([0xA2, 50, 127])
    assert client.nudge()[0] == 0x80
    assert client.result == SdoResult(INDEX, 5, abort=TIMED_OUT, by_server=False)


@pytest.mark.parametrize(
    ("code", "text"), [(0x06020000, "does not exist"), (0x06010002, "write"), (0x12345678, "Unknown")]
)
def test_abort_codes_are_reported_in_words(code: int, text: str) -> None:
    """An abort code is reported in words with its number, also an unknown one."""
    client = SdoClient()
    client.start_write(0x4000, 0, b"\4")
    client.feed(bytes.fromhex("80004000") + code.to_bytes(4, "little"))
    assert client.result is not None
    assert text in client.result.text
    assert f"0x{code:08X}" in client.result.text


@settings(deadline=None)
@given(st.booleans(), st.lists(st.binary(max_size=8), max_size=30))
def test_no_messages_make_the_client_fail(block: bool, messages: list[bytes]) -> None:
    """Random messages cause no exception, and a transfer works afterwards."""
    client = SdoClient()
    client.start_read(INDEX, 0, block=block)
    for message in messages:
        client.feed(message)
    server = library_server(b"content of more than seven bytes", [])
    assert run(client, client.start_read(INDEX, 0), server).data == b"content of more than seven bytes"


@settings(deadline=None)
@given(st.lists(st.binary(min_size=8, max_size=8), max_size=30))
def test_no_messages_make_the_simulated_block_server_fail(messages: list[bytes]) -> None:
    """Random messages cause no exception in the simulated block server."""
    server = BlockServer(lambda *_: bytes(20))
    for message in messages:
        if BlockServer.is_block_upload(message):
            server.respond(message)
