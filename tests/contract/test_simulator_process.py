"""The simulator as a process on a pseudo-terminal and on TCP."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage, Telemetry, TransferDone
from gss.device.simulator.program import main
from gss.device.transport import open_stream
from gss.domain.errors import BadInput, Conflict, LinkDown, NotFound
from gss.skytables.pairs import distance_table

if TYPE_CHECKING:
    from conftest import Contact, Simulator

Start = Callable[..., "Simulator"]
Open = Callable[[str], "Contact"]


def catalogue() -> bytes:
    stars = load_stars(3.6)
    return encode(stars, distance_table(stars, 0.0044, 1.0), "cubestar", "cubestar")


def compatible(contact: Contact) -> Compatibility:
    hello = contact.host.hello
    assert hello is not None
    return Compatibility(hello.device_model, hello.profile, bytes.fromhex(hello.dictionary_hash), 1, 1991.25)


@pytest.mark.parametrize("place", ["pty", "tcp"])
def test_the_main_job_over_a_real_line(simulator: Start, contact: Open, tmp_path: Path, place: str) -> None:
    """An image is taken, downloaded and solved on board; a catalogue is uploaded, verified, activated and confirmed. The
    state remains after a restart."""
    where = ["--tcp", "0"] if place == "tcp" else ["--symlink", str(tmp_path / "port")]
    options = [*where, "--state-dir", str(tmp_path / "state"), "--baud", "0", "--attitude", "84,5,20", "--speed", "5"]
    unit = simulator(*options)
    c = contact(unit.url)
    taken = c.do("TAKE_IMAGE", slot=1)
    update = c.finish(c.host.transfers.start_download("frame", 1))
    assert update.state == "verified"
    (frame,) = [e for e in c.events if isinstance(e, TransferDone)]
    assert (len(frame.data), frame.frame_number) == (1024 * 512, taken.values["frame_number"])
    (info,) = [e for e in c.events if isinstance(e, Telemetry) and e.packet == "frame_info"]
    assert hashlib.sha256(frame.data).digest() == info.values["sha256"]
    assert np.frombuffer(frame.data, np.uint8).max() > 100
    assert c.do("RUN_ITERATION").values["outcome"] == "solved"
    image = catalogue()
    up = c.finish(c.host.transfers.start_upload("catalogue", 1, image, compatible(c)))
    assert (up.state, up.stored_bytes) == ("committed", len(image))
    assert c.do("VERIFY_BANK", bank="B").values["sha256"] == hashlib.sha256(image).digest()
    assert c.do("ACTIVATE_BANK", bank="B").stage is Stage.COMPLETED
    assert c.do("CONFIRM_BANK", bank="B").stage is Stage.COMPLETED
    assert c.do("RUN_ITERATION").values["outcome"] == "solved"
    c.stream.close()
    assert unit.stop() == 0
    again = contact(simulator(*options).url)
    again.do("GET_STATUS")
    assert again.host.housekeeping is not None
    assert again.host.housekeeping["active_bank"] == "B"
    assert again.host.housekeeping["last_frame"] == 3
    assert again.host.hello is not None
    assert again.host.hello.boot_count == 2


def test_a_killed_simulator_is_a_lost_line_and_the_upload_resumes(
    simulator: Start, contact: Open, tmp_path: Path
) -> None:
    """After a crash of the device during a write, the upload resumes with the content of its flash file."""
    options = ["--tcp", "0", "--state-dir", str(tmp_path), "--baud", "921600"]
    unit = simulator(*options)
    c, image = contact(unit.url), catalogue()
    transfer_id = c.host.transfers.start_upload("catalogue", 2, image, compatible(c))
    c.until(lambda: c.host.transfer(transfer_id).stored_bytes > len(image) // 2)
    unit.process.kill()
    with pytest.raises(LinkDown):
        c.until(lambda: False)
    second = contact(simulator(*options).url)
    again = second.finish(second.host.transfers.start_upload("catalogue", 2, image, compatible(second)))
    assert (again.state, again.resumed) == ("committed", True)
    assert second.host.counters.sent.bytes < 0.7 * len(image)


def test_the_process_ends_with_its_input_and_removes_its_name(simulator: Start, tmp_path: Path) -> None:
    """The simulator ends and removes its link when its standard input is closed."""
    link = tmp_path / "port"
    unit = simulator("--symlink", str(link))
    assert link.is_symlink()
    assert unit.url == str(link)
    assert unit.process.stdin is not None
    unit.process.stdin.close()
    unit.process.stdin = None
    assert unit.process.wait(20) == 0
    assert not link.is_symlink()


def test_a_port_is_owned_by_one_process(simulator: Start) -> None:
    """A second process is rejected with the name of the owner. It can open the port after the owner has closed it."""
    unit = simulator("--baud", "0")
    first = open_stream(unit.url)
    with pytest.raises(Conflict, match="another process uses"):
        open_stream(unit.url)
    first.close()
    first.close()
    open_stream(unit.url).close()


def test_lines_that_cannot_be_opened_give_the_reason(simulator: Start, tmp_path: Path) -> None:
    """Missing ports, plain files, closed listeners and invalid addresses give an error with the reason."""
    plain = tmp_path / "file"
    plain.write_text("")
    with pytest.raises(NotFound):
        open_stream(str(tmp_path / "nothing"))
    with pytest.raises(BadInput, match="not a serial port"):
        open_stream(str(plain))
    with pytest.raises(BadInput):
        open_stream("")
    unit = simulator("--tcp", "0")
    unit.stop()
    with pytest.raises(LinkDown):
        open_stream(unit.url)
    for other_scheme in ("nonsense://x", "spy:///dev/null?file=x", "loop://"):
        with pytest.raises(BadInput):
            open_stream(other_scheme)


@pytest.mark.parametrize("options", [["--attitude", "1,2"], ["--attitude", "1,95,0"], ["--speed", "0"]])
def test_bad_options_end_with_code_2(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Invalid options give exit code 2 and a message on standard error, and READY is not printed."""
    assert main(["--instrument", "cubestar", *options]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert "Expected" in output.err


def test_gss_simulate_is_the_same_process(tmp_path: Path) -> None:
    """The command passes its options to the simulator and prints its READY, and SIGTERM ends both processes."""
    command = [sys.executable, "-m", "gss", "simulate", "--tcp", "0", "--exit-with-stdin"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ.copy()
    ) as child:
        assert child.stdout is not None
        assert child.stdin is not None
        assert child.stdout.readline().startswith("READY socket://127.0.0.1:")
        child.stdin.close()
        assert child.wait(20) == 0
