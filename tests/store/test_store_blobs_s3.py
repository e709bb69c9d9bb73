"""Blobs in an object store: an S3 server program on this machine (moto), accessed over HTTP."""

from __future__ import annotations

import contextlib
import hashlib
import os
import socket
import threading
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

from gss.domain.errors import BadInput, CorruptData, NotFound, StoreDown
from gss.store.blobs import BlobStore, _options

pytest.importorskip("s3fs")
BUCKET = "frames-of-tests"


@pytest.fixture
def s3(s3_server: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """URL of an empty prefix. The address and credentials of the store are in the environment only."""
    import s3fs

    for name, value in (
        ("AWS_ENDPOINT_URL_S3", s3_server),
        ("AWS_ACCESS_KEY_ID", "tester"),
        ("AWS_SECRET_ACCESS_KEY", "not-in-any-url"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    fs = s3fs.S3FileSystem()
    if not fs.exists(BUCKET):
        fs.mkdir(BUCKET)
    prefix = f"{BUCKET}/{os.urandom(4).hex()}"
    yield f"s3://{prefix}"
    s3fs.S3FileSystem.clear_instance_cache()


def stored_object(url: str, key: str) -> tuple[object, str]:
    """Return the file system of a store and the object path of a key."""
    import s3fs

    return s3fs.S3FileSystem(), f"{url.removeprefix('s3://')}/{key[:2]}/{key[2:]}"


def test_an_object_store_behaves_like_a_folder(s3: str, tmp_path) -> None:
    """Object store and folder have the same keys for the same bytes. Listing, size, presence and removal agree."""
    stores = [BlobStore(s3), BlobStore(str(tmp_path / "blobs"))]
    contents = [b"", b"pixels", os.urandom(300_000), b"pixels"]
    for store in stores:
        keys = [store.put(data) for data in contents]
        assert keys == [hashlib.sha256(data).hexdigest() for data in contents]
        assert [store.get(key) for key in keys] == contents
        assert list(store.keys()) == sorted(set(keys))
        assert [store.size(key) for key in keys] == [len(data) for data in contents]
        store.delete(keys[1])
        store.delete(keys[1])
        assert [store.exists(key) for key in keys] == [True, False, True, False]
        for operation in (store.get, store.size):
            with pytest.raises(NotFound, match="missing"):
                operation(keys[1])


def test_damaged_objects_are_reported_and_repaired_by_their_next_copy(s3: str) -> None:
    """Objects with other bytes and truncated objects are reported as damaged. Storing the content again repairs them."""
    store = BlobStore(s3)
    key = store.put(b"the sky over Stellenbosch")
    fs, path = stored_object(s3, key)
    for damage in (b"the sky over Stellenbosch!", b"the sky", b""):
        fs.pipe_file(path, damage)
        with pytest.raises(CorruptData, match="damaged"):
            store.get(key)
    assert store.put(b"the sky over Stellenbosch") == key
    assert store.get(key) == b"the sky over Stellenbosch"


def test_a_write_that_fails_leaves_no_key(s3: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only complete objects have keys. A failed write leaves no partial object and no temporary name."""
    store = BlobStore(s3)
    with monkeypatch.context() as patched:
        patched.setattr(store._fs, "pipe_file", lambda *_: (_ for _ in ()).throw(ConnectionResetError("line cut")))
        with pytest.raises(StoreDown, match="line cut"):
            store.put(b"half")
    assert list(store.keys()) == []
    store.put(b"whole")
    fs, _ = stored_object(s3, "0" * 64)
    assert [name.rsplit("/", 1)[1] for name in fs.find(s3)] == [hashlib.sha256(b"whole").hexdigest()[2:]]


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 503 Slow Down\r\nContent-Length: 0\r\n\r\n"])
def test_a_silent_or_busy_store_is_reported_as_down(answer: bytes, s3: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A store that accepts a connection and does not respond, or rejects requests, is StoreDown after limited retries."""
    import s3fs

    with socket.create_server(("127.0.0.1", 0)) as listener:
        accepted: list[socket.socket] = []

        def accept() -> None:
            while True:
                try:
                    accepted.append(listener.accept()[0])
                    if answer:
                        accepted[-1].recv(65536)
                        accepted[-1].sendall(answer)
                except OSError:
                    return

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        store = BlobStore(s3, timeout_s=0.3)
        key = store.put(b"there")
        monkeypatch.setenv("AWS_ENDPOINT_URL_S3", f"http://127.0.0.1:{listener.getsockname()[1]}")
        s3fs.S3FileSystem.clear_instance_cache()
        with pytest.raises(StoreDown):
            BlobStore(s3, timeout_s=0.3).get(key)
        for sock in accepted:
            sock.close()


def test_a_wrong_bucket_or_address_is_reported_at_the_start(s3: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing bucket and an unreachable address are reported at the start. Credentials in the URL are rejected, and the
    error does not repeat them."""
    import s3fs

    with pytest.raises(StoreDown, match="bucket"):
        BlobStore("s3://no-such-bucket-here/frames")
    with pytest.raises(BadInput) as error:
        BlobStore("s3://tester:hunter2@bucket/frames")
    assert "hunter2" not in str(error.value)
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", f"http://127.0.0.1:{port}")
    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(StoreDown):
        BlobStore(s3, timeout_s=0.3)
    assert urlsplit(s3).netloc == BUCKET


def test_a_store_whose_response_never_ends_is_down_after_the_deadline(s3: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A response that arrives byte by byte never exceeds the timeout of a single step. The overall deadline ends the
    request, the next request fails without another connection, and the health check reports the failure.
    """
    import s3fs

    with socket.create_server(("127.0.0.1", 0)) as listener:
        connections: list[socket.socket] = []

        def trickle(peer: socket.socket) -> None:
            with peer, contextlib.suppress(OSError):
                peer.sendall(b"HTTP/1.1 200 OK\r\nX-Slow: ")
                while not ended.wait(0.05):
                    peer.sendall(b"a")

        def accept() -> None:
            while True:
                try:
                    connections.append(listener.accept()[0])
                except OSError:
                    return
                thread = threading.Thread(target=trickle, args=(connections[-1],), daemon=True)
                thread.start()  # started before the test can join it
                threads.append(thread)

        ended, threads = threading.Event(), list[threading.Thread]()
        threading.Thread(target=accept, daemon=True).start()
        store = BlobStore(s3, timeout_s=0.3)
        key = store.put(b"there")
        assert store.check() == "the object store responds"
        monkeypatch.setenv("AWS_ENDPOINT_URL_S3", f"http://127.0.0.1:{listener.getsockname()[1]}")
        s3fs.S3FileSystem.clear_instance_cache()
        store._fs = s3fs.S3FileSystem(**_options(s3, 60.0))
        with pytest.raises(StoreDown, match=r"within 5\.6 s"):
            store.size(key)
        count = len(connections)
        assert count >= 1
        with pytest.raises(StoreDown, match="earlier request"):
            store.size(key)
        with pytest.raises(StoreDown):
            store.check()
        assert len(connections) == count
        ended.set()
        for thread in threads:
            thread.join(10)
