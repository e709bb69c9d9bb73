"""Seeds of the targets in ``tools.fuzz_foreign_targets``: small valid files and bytes of other systems."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import numpy as np

from gss.device.can_frames import CanFrame
from gss.device.xtce import xtce_of
from gss.instruments.package_source import write_zip
from gss.instruments.registry import shipped_registry
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.oem import oem_of
from gss.orbit.omm import omm_of_tle
from gss.orbit.trajectory import TleTrajectory
from gss.orbit.write_attitude import acm_of, aem_of
from tools.fuzz_foreign_targets import CAN_RECORD, SAGITTA_RECORD

TLE = (
    "1 25544U 98067A   26150.51782528  .00016717  00000-0  10270-3 0  9009\n"
    "2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49560532    08\n"
)
CREATED = datetime(2026, 6, 1, tzinfo=UTC)
CAN_FRAMES = ("72c 05", "5ac 4f00000000000000", "1ac 0123456789abcdef", "2ac 0001020304050607", "0ac 1000010200000000")
"""Heartbeat, response, process data and emergency of node 0x2c."""


def measured_npz() -> bytes:
    """Return two lists of measured stars as an .npz file."""
    out, values = io.BytesIO(), np.array([1.5, 200.25, 37.0])
    np.savez(out, col_px=values, row_px=values[::-1], flux=values * 100, first=np.array([0, 2, 3]))
    return out.getvalue()


def foreign_seeds() -> Iterator[tuple[str, str, bytes]]:
    """Yield (target, name, bytes) of each seed."""
    history = AttitudeHistory(
        "ZA-1",
        "STARTRACKER_1",
        CREATED.timestamp() + np.arange(3.0),
        np.tile([0.5, 0.5, 0.5, 0.5], (3, 1)),
        np.full((3, 3), 1e-5),
    )
    yield "attitude-message", "aem", "".join(aem_of(history, CREATED)).encode()
    yield "attitude-message", "acm", "".join(acm_of(history, "DETERMINED_OBC", CREATED)).encode()
    orbit, fields = TleTrajectory.of(TLE), omm_of_tle("ISS", TLE)
    kvn = "CCSDS_OMM_VERS = 2.0\n" + "".join(f"{key} = {value}\n" for key, value in fields.items())
    xml = "".join(f"<{key}>{value}</{key}>" for key, value in fields.items())
    oem = oem_of("ISS", orbit, orbit.epoch, orbit.epoch + timedelta(minutes=12), 60.0, CREATED)
    for name, text in (
        ("tle", f"ISS\n{TLE}"),
        ("two", TLE + TLE),
        ("omm-json", json.dumps([fields])),
        ("omm-kvn", kvn),
        ("omm-xml", f"<ndm><omm><body><segment><data>{xml}</data></segment></body></omm></ndm>"),
        ("oem", "".join(oem)),
    ):
        yield "orbit-message", name, text.encode()
    registry = shipped_registry()
    yield "xtce", "nos3", xtce_of(registry.get("nos3")).encode()
    for name, files in (
        ("aim", ("camera.yaml", "catalogue.yaml", "instrument.yaml", "simulator.yaml")),
        ("nos3", ("dictionary.yaml", "operations.yaml", "link.yaml")),
        ("oresat", ("operations.yaml",)),
    ):
        package = registry.get(name)
        for file in files:
            yield "package", f"{name}-{file.partition('.')[0]}", f"{name}/{file}\n".encode() + package.files[file]
    yield "package-zip", "aim", write_zip("aim", registry.get("aim").files)
    for name, text in registry.get("aim").procedures.items():
        yield "procedure", name.partition(".")[0], text.encode()
    yield "procedure", "branches", PROCEDURE.encode()
    yield "measured-lists", "csv", b"list,col_px,row_px,flux\n0,1.5,2,300\n0,7,8.25,90\n1,3,4,5\n"
    yield "measured-lists", "npz", measured_npz()
    first = io.BytesIO()
    np.save(first, np.array([0, 2, 3]))
    yield "measured-lists", "npy", first.getvalue()
    frames = [(int(head, 16), bytes.fromhex(data)) for head, data in (text.split() for text in CAN_FRAMES)]
    yield "can-records", "frames", b"".join(CanFrame(number, data).record() for number, data in frames)
    yield "oresat", "frames", b"".join(CAN_RECORD.pack(number, len(data)) + data for number, data in frames)
    contents = [
        (0x80, 0, bytes(1)),
        (0x82, 24, bytes(60)),
        (0x82, 27, bytes(24)),
        (0x81, 3, bytes(9)),
        (0x84, 24, bytes(60)),
    ]
    yield "sagitta", "packets", b"".join(SAGITTA_RECORD.pack(k, n, len(data)) + data for k, n, data in contents)


PROCEDURE = """# Test

Introduction.

## first: First step

```check
housekeeping.sensor_temperature_c < 40 and housekeeping.mode == "standby"
```

## choose: Choose

```branch
if housekeeping.cycle_running: last
else: end
```

## last: Last step

```command
SET_EXPOSURE exposure_ms=250
```
"""
