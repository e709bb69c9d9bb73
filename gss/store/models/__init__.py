"""Models of the database tables, one module per subject. Importing this package registers all tables."""

from gss.store.models.accounts import ApiToken, AuditRow, OneTimeLink, SignIn, User
from gss.store.models.automation import DerivedParameter, Notification, Procedure, ProcedureRun
from gss.store.models.base import Base, UtcDateTime
from gss.store.models.catalogues import BankHistory, Catalogue, DeviceTable, StarList
from gss.store.models.console import Alarm, Authority, Choice, Job
from gss.store.models.frames import Frame, Solution
from gss.store.models.handover import ChecklistMark, ChecklistVersion, HandoverNote
from gss.store.models.heads import FusedRow, HeadPairRow, Spacecraft
from gss.store.models.link import (
    Command,
    CommandStage,
    Contact,
    Device,
    Event,
    TelemetryPacket,
    TelemetryRollup,
    Transfer,
)
from gss.store.models.passes import OrbitSet, PassPlan, Station
from gss.store.models.studies import Analysis, Calibration, ListRun
from gss.store.models.views import SharedView, SharedViewVersion

__all__ = [
    "Alarm",
    "Analysis",
    "ApiToken",
    "AuditRow",
    "Authority",
    "BankHistory",
    "Base",
    "Calibration",
    "Catalogue",
    "ChecklistMark",
    "ChecklistVersion",
    "Choice",
    "Command",
    "CommandStage",
    "Contact",
    "DerivedParameter",
    "Device",
    "DeviceTable",
    "Event",
    "Frame",
    "FusedRow",
    "HandoverNote",
    "HeadPairRow",
    "Job",
    "ListRun",
    "Notification",
    "OneTimeLink",
    "OrbitSet",
    "PassPlan",
    "Procedure",
    "ProcedureRun",
    "SharedView",
    "SharedViewVersion",
    "SignIn",
    "Solution",
    "Spacecraft",
    "StarList",
    "Station",
    "TelemetryPacket",
    "TelemetryRollup",
    "Transfer",
    "User",
    "UtcDateTime",
]
