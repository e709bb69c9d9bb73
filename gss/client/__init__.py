"""Python client of a GSS server: commands, telemetry, transfers, frames, catalogues, procedures and events.

It needs httpx2 and NumPy only, and imports nothing else of GSS. Create an API token on the page *Admin*, or with
``gss token create``, and keep it in the environment variable ``GSS_TOKEN``::

    from gss.client import Client

    with Client("http://localhost:8181") as gss, gss.authority():
        gss.send("TAKE_IMAGE", exposure_ms=200)
        for packet in gss.follow("housekeeping"):
            print(packet.received, packet.values["sensor_temperature_c"])
"""

from gss.client.client import Client
from gss.client.errors import (
    ClientError,
    CommandFailed,
    JobFailed,
    NotAllowed,
    ProcedureFailed,
    ServerAway,
    TimedOut,
    TransferFailed,
)
from gss.client.records import (
    Command,
    Event,
    Frame,
    Job,
    Packet,
    Procedure,
    ProcedureRun,
    Solution,
    Star,
    TelemetryValue,
    Transfer,
)

__all__ = [
    "Client",
    "ClientError",
    "Command",
    "CommandFailed",
    "Event",
    "Frame",
    "Job",
    "JobFailed",
    "NotAllowed",
    "Packet",
    "Procedure",
    "ProcedureFailed",
    "ProcedureRun",
    "ServerAway",
    "Solution",
    "Star",
    "TelemetryValue",
    "TimedOut",
    "Transfer",
    "TransferFailed",
]
