"""The interface document is sufficient: a client written from it alone operates a simulator process."""

from __future__ import annotations

import ast
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.contract.clean_room_client import EVENT, CleanRoomClient

if TYPE_CHECKING:
    from conftest import Simulator

BANK_B, GOLDEN = 1, 3


@pytest.fixture
def client(simulator: Callable[..., Simulator], root: Path) -> Iterator[CleanRoomClient]:
    unit = simulator("--tcp", "0", "--baud", "0", "--attitude", "84,5,20")
    one = CleanRoomClient(root / "docs" / "icd.md", "127.0.0.1", int(unit.url.rpartition(":")[2]))
    yield one
    one.close()


def test_the_client_imports_nothing_of_gss(root: Path) -> None:
    """The client imports nothing of gss, because it tests the document."""
    tree = ast.parse((root / "tests" / "contract" / "clean_room_client.py").read_text())
    names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    names |= {str(n.module) for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert not {name for name in names if name.split(".")[0] == "gss"}


def test_the_document_alone_is_enough_for_an_image(client: CleanRoomClient) -> None:
    """HELLO, status, time, an image with its attitude, its download, the thumbnail, and ABORT."""
    hello = client.hello()
    assert (hello["stage"], hello["dictionary_hash"]) == ("completed", client.icd.hash)
    assert (hello["profile"], hello["columns"], hello["rows"], hello["bits"]) == ("cubestar", 1024, 512, 8)

    now_s = time.time()
    assert client.command("SET_TIME", utc_s=now_s)["stage"] == "completed"
    assert client.command("GET_STATUS")["stage"] == "completed"
    status = client.telemetry("housekeeping")
    assert status["time_set"]
    assert abs(status["utc_s"] - now_s) < 5

    assert client.command("SET_MODE", mode="lost_in_space")["stage"] == "completed"
    solved = client.command("RUN_ITERATION", slot=2)
    assert (solved["stage"], solved["outcome"]) == ("completed", "solved")
    client.command("GET_STATUS")
    status = client.telemetry("housekeeping")
    assert status["mode"] == "tracking"  # clause 5.10
    q = np.array([status[f"quaternion_{axis}"] for axis in "xyzw"])
    assert attitude_of(q) == pytest.approx([status["ra_deg"], status["dec_deg"], status["roll_deg"]], abs=0.01)
    assert [status["ra_deg"], status["dec_deg"], status["roll_deg"]] == pytest.approx([84, 5, 20], abs=0.1)

    info = client.telemetry("frame_info")
    data = client.download("frame", 2)
    image = np.frombuffer(data, np.uint8).reshape(hello["rows"], hello["columns"])
    assert (info["slot"], len(data)) == (2, info["rows"] * info["columns"])
    brightest = client.telemetry("centroids")
    assert brightest["frame_number"] == info["frame_number"]
    small = np.frombuffer(client.download("thumbnail", 2), np.uint8).reshape(128, 256)
    means = image.reshape(128, 4, 256, 4).mean(axis=(1, 3))
    assert np.array_equal(small, np.rint(means).astype(np.uint8))  # clause 7.9

    assert client.command("START_CYCLE")["stage"] == "completed"
    assert client.command("ABORT")["stage"] == "completed"
    client.command("GET_STATUS")
    assert client.telemetry("housekeeping")["cycle_running"] is False
    assert [p for p in client.packets if p.type == EVENT]
    assert client.damaged == 0


def test_the_document_alone_is_enough_for_a_catalogue(client: CleanRoomClient) -> None:
    """A bank is read back, a smaller catalogue is made from it, uploaded, verified, committed and listed."""
    hello = client.hello()
    golden = client.download("catalogue", GOLDEN)
    image, stars, pairs = smaller_catalogue(golden, 60)
    facts = {
        "device_model": hello["device_model"],
        "profile": hello["profile"],
        "dictionary_hash": hello["dictionary_hash"],
        "format_version": 1,
        "epoch_jyear": struct.unpack_from("<d", golden, 16)[0],
        "stars": stars,
        "pairs": pairs,
    }
    client.upload("catalogue", BANK_B, image, facts)
    assert client.command("LIST_BANKS")["stage"] == "completed"
    section = client.icd.sections["bank_info"]
    banks = [p.payload for p in client.packets if (p.type, p.code) == (3, section.code)]
    assert len(banks) >= 4
    assert client.download("catalogue", BANK_B)[: len(image)] == image
    with pytest.raises(RuntimeError, match=r"bank_active|write_protected"):
        client.upload("catalogue", GOLDEN, image, facts)


def attitude_of(q: np.ndarray) -> list[float]:
    """Right ascension, declination and roll in degrees, by clause 5.11."""
    x, y, z, w = q / np.linalg.norm(q)
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    boresight, north = turned.T @ [0, 0, 1], turned @ [0, 0, 1]
    angles = [np.arctan2(boresight[1], boresight[0]), np.arcsin(boresight[2]), np.arctan2(-north[0], -north[1])]
    return [float(np.degrees(a)) % 360 for a in angles]


def smaller_catalogue(image: bytes, keep: int) -> tuple[bytes, int, int]:
    """Return a bank image of the first ``keep`` stars, and its numbers of stars and pairs, by clauses 7.4 and 7.10."""
    n, m = struct.unpack_from("<II", image, 8)
    assert image[:6] == b"GSSB\x01\x01"
    at = 64 + 2 * n
    axes = [np.frombuffer(image, "<f4", n, at + 4 * n * axis)[:keep] for axis in range(3)]
    first, second, distance = (
        np.frombuffer(image, kind, m, 64 + 14 * n + offset * m) for kind, offset in (("<i2", 0), ("<i2", 2), ("<f4", 4))
    )
    kept = (first < keep) & (second < keep)
    body = np.arange(keep, dtype="<i2").tobytes() + b"".join(a.tobytes() for a in axes)
    body += first[kept].tobytes() + second[kept].tobytes() + distance[kept].tobytes()
    head = image[:8] + struct.pack("<II", keep, int(kept.sum())) + image[16:56] + struct.pack("<I", zlib.crc32(body))
    return head + struct.pack("<I", zlib.crc32(head)) + body, keep, int(kept.sum())
