"""Standard operations that the ground can request from a sensor, and the instrument's command for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gss.domain.errors import BadInput, Conflict
from gss.instruments.dictionary.checked_values import check_argument
from gss.instruments.dictionary.definitions import INTEGER_RANGES, Argument, Dictionary, Value, Values
from gss.instruments.quantities import Strict

SLOT, BANK, TABLE, SCHEDULE_ID = "slot", "bank", "table", "schedule_id"
AT_S, COMMAND_CODE, LENGTH, PAYLOAD = "at_s", "command_code", "length", "payload"
RA_DEG, DEC_DEG, ROLL_DEG, UNCERTAINTY_DEG = "ra_deg", "dec_deg", "roll_deg", "uncertainty_deg"
RAAN_DEG, INCLINATION_DEG, LATITUDE_DEG = "raan_deg", "inclination_deg", "latitude_deg"
ALTITUDE_KM, EPOCH_S, PITCH_DEG, YAW_DEG = "altitude_km", "epoch_s", "pitch_deg", "yaw_deg"

Name = Annotated[str, Field(min_length=1, max_length=60)]


class Operation(StrEnum):
    """A standard operation; the value is its key in ``operations.yaml``."""

    HELLO = "hello"
    GET_STATUS = "get_status"
    RESET = "reset"
    ABORT = "abort"
    SET_TIME = "set_time"
    SET_MODE = "set_mode"
    SET_EXPOSURE = "set_exposure"
    TAKE_IMAGE = "take_image"
    FIND_CENTROIDS = "find_centroids"
    MATCH_STARS = "match_stars"
    CALCULATE_ATTITUDE = "calculate_attitude"
    RUN_ITERATION = "run_iteration"
    START_CYCLE = "start_cycle"
    STOP_CYCLE = "stop_cycle"
    LIST_FRAMES = "list_frames"
    DOWNLOAD_FRAME = "download_frame"
    DOWNLOAD_WINDOW = "download_window"
    UPLOAD_IMAGE = "upload_image"
    UPLOAD_CATALOGUE = "upload_catalogue"
    UPLOAD_PARAMETERS = "upload_parameters"
    READ_BACK = "read_back"
    LIST_BANKS = "list_banks"
    VERIFY = "verify"
    ACTIVATE = "activate"
    CONFIRM = "confirm"
    ROLL_BACK = "roll_back"
    ERASE = "erase"
    LIST_TABLES = "list_tables"
    VERIFY_TABLE = "verify_table"
    ACTIVATE_TABLE = "activate_table"
    CONFIRM_TABLE = "confirm_table"
    ROLL_BACK_TABLE = "roll_back_table"
    ERASE_TABLE = "erase_table"
    SCHEDULE = "schedule"
    LIST_SCHEDULE = "list_schedule"
    CANCEL_SCHEDULED = "cancel_scheduled"
    SET_ORBIT = "set_orbit"
    SET_HINT = "set_hint"
    SET_PRIOR = "set_prior"


BANK_OPERATIONS = (
    Operation.LIST_BANKS,
    Operation.VERIFY,
    Operation.ACTIVATE,
    Operation.CONFIRM,
    Operation.ROLL_BACK,
    Operation.ERASE,
)
TABLE_OPERATIONS = (
    Operation.LIST_TABLES,
    Operation.VERIFY_TABLE,
    Operation.ACTIVATE_TABLE,
    Operation.CONFIRM_TABLE,
    Operation.ROLL_BACK_TABLE,
    Operation.ERASE_TABLE,
)

ARGUMENTS: Mapping[Operation, tuple[str, ...]] = {
    Operation.SET_TIME: ("utc_s",),
    Operation.SET_MODE: ("mode",),
    Operation.SET_EXPOSURE: ("exposure_s",),
    Operation.TAKE_IMAGE: (SLOT, "exposure_s"),
    Operation.RUN_ITERATION: (SLOT,),
    Operation.FIND_CENTROIDS: (SLOT,),
    Operation.VERIFY: (BANK,),
    Operation.ACTIVATE: (BANK, "confirm_within_s"),
    Operation.CONFIRM: (BANK,),
    Operation.ERASE: (BANK,),
    Operation.VERIFY_TABLE: (TABLE, BANK),
    Operation.ACTIVATE_TABLE: (TABLE, BANK, "confirm_within_s"),
    Operation.CONFIRM_TABLE: (TABLE,),
    Operation.ROLL_BACK_TABLE: (TABLE,),
    Operation.ERASE_TABLE: (TABLE, BANK),
    Operation.SCHEDULE: (AT_S, COMMAND_CODE, LENGTH, PAYLOAD),
    Operation.CANCEL_SCHEDULED: (SCHEDULE_ID,),
    Operation.SET_HINT: (RA_DEG, DEC_DEG, ROLL_DEG, UNCERTAINTY_DEG),
    Operation.SET_ORBIT: (RAAN_DEG, INCLINATION_DEG, LATITUDE_DEG, ALTITUDE_KM, EPOCH_S),
    Operation.SET_PRIOR: (ROLL_DEG, PITCH_DEG, YAW_DEG, UNCERTAINTY_DEG),
}
"""Arguments of the operations that have arguments. The name states the unit."""

TRANSFERS = (
    Operation.DOWNLOAD_FRAME,
    Operation.DOWNLOAD_WINDOW,
    Operation.UPLOAD_IMAGE,
    Operation.UPLOAD_CATALOGUE,
    Operation.UPLOAD_PARAMETERS,
    Operation.READ_BACK,
)
"""Operations that are transfers instead of commands; the driver transfers their content."""

CANNOT: Mapping[Operation, str] = {
    Operation.DOWNLOAD_FRAME: "download images",
    Operation.DOWNLOAD_WINDOW: "download parts of an image",
    Operation.UPLOAD_IMAGE: "accept an uploaded image",
    Operation.UPLOAD_CATALOGUE: "accept a catalogue",
    Operation.UPLOAD_PARAMETERS: "accept tables",
    Operation.READ_BACK: "send the content of a bank",
    Operation.SCHEDULE: "run commands at a later time",
}
"""Text that follows "cannot" in the message for a missing operation. Other operations are described by their key."""


class ArgumentRow(Strict):
    """Mapping of a standard argument to the argument ``name`` of the command: the value is multiplied by ``scale``."""

    name: Name
    scale: Annotated[float, Field(gt=0)] = 1.0


class OperationRow(Strict):
    """The command of an operation, or the kind of content that it transfers. ``arguments``: arguments of the command by standard
    name; an argument without an entry has the standard name and unit. ``fixed``: arguments with a constant value.
    ``content``: content of a downloaded frame, either the detector's pixels or an image file (PNG, TIFF, JPEG)."""

    command: Name | None = None
    transfer: Name | None = None
    content: Literal["pixels", "image_file"] = "pixels"
    arguments: Mapping[str, ArgumentRow] = Field(default_factory=dict)
    fixed: Mapping[str, int | float | bool | str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if (self.command is None) == (self.transfer is None):
            raise ValueError("needs either a command or a kind of transfer")
        return self


@dataclass(frozen=True)
class Call:
    """A command of the instrument and its arguments."""

    command: str
    arguments: dict[str, Value]


class StandardOperations:
    """Operations of an instrument by their standard names. ``dictionary``: defines the commands of the instrument."""

    def __init__(self, rows: Mapping[Operation, OperationRow], dictionary: Dictionary) -> None:
        self._rows, self.dictionary = dict(rows), dictionary

    def names(self) -> tuple[Operation, ...]:
        """Return the operations of the instrument."""
        return tuple(self._rows)

    def has(self, operation: Operation) -> bool:
        """True if the instrument has the operation."""
        return operation in self._rows

    def require(self, operation: Operation) -> OperationRow:
        """Return the row of an operation. Raises Conflict, with a sentence for the operator, if the instrument lacks
        the operation."""
        if operation not in self._rows:
            raise Conflict(absence(operation))
        return self._rows[operation]

    def command(self, operation: Operation) -> str:
        """Return the name of the operation's command. Raises Conflict if the instrument lacks the operation."""
        return self.require(operation).command or ""

    def title(self, operation: Operation) -> str:
        """Return the name of the operation's command; without a command, the name of the operation."""
        row = self._rows.get(operation)
        return (row.command if row is not None else None) or operation.value

    def of_command(self, command: str, arguments: Values) -> Operation | None:
        """Return the operation of a command with its arguments; None without a standard operation. Several operations can
        share a command: the operation with most ``fixed`` arguments of which all have these values is returned."""
        fitting = [
            operation
            for operation, row in self._rows.items()
            if row.command == command and self._has_fixed(row, arguments)
        ]
        return max(fitting, key=lambda operation: len(self._rows[operation].fixed), default=None)

    def _has_fixed(self, row: OperationRow, arguments: Values) -> bool:
        """True if the arguments, or their defaults, have the constant values of a row."""
        for name, value in row.fixed.items():
            argument = self.dictionary.command(row.command or "").argument(name)
            sent = arguments.get(name, argument.default)
            if sent is None or _comparable(argument, sent) != _comparable(argument, value):
                return False
        return True

    def call(self, operation: Operation, supplied: Values | None = None) -> Call:
        """Return the operation's command, with its arguments converted from standard arguments. Raises Conflict if the
        instrument lacks the operation."""
        row, command = self.require(operation), self.dictionary.command(self.command(operation))
        arguments: dict[str, Value] = dict(row.fixed)
        for name, value in (supplied or {}).items():
            mapped = row.arguments.get(name, ArgumentRow(name=name))
            arguments[mapped.name] = value
            if mapped.scale != 1.0 and isinstance(value, int | float):
                scaled = value * mapped.scale
                arguments[mapped.name] = (
                    round(scaled) if command.argument(mapped.name).type in INTEGER_RANGES else scaled
                )
        return Call(command.name, arguments)

    def given(self, operation: Operation, arguments: Values) -> dict[str, Value]:
        """Return the standard arguments of a command that was sent, without arguments that it did not contain."""
        row, values_by_argument = self.require(operation), dict[str, Value]()
        for name in ARGUMENTS.get(operation, ()):
            mapped = row.arguments.get(name, ArgumentRow(name=name))
            if mapped.name in arguments:
                value = arguments[mapped.name]
                values_by_argument[name] = (
                    value / mapped.scale if mapped.scale != 1.0 and isinstance(value, int | float) else value
                )
        return values_by_argument

    def argument(self, operation: Operation, name: str) -> str:
        """Return the instrument's name for a standard argument."""
        row = self.require(operation)
        return row.arguments[name].name if name in row.arguments else name

    def table_kinds(self) -> tuple[str, ...]:
        """Return the kinds of tables in the interface; empty if the sensor has no tables."""
        if not self.has(Operation.VERIFY_TABLE):
            return ()
        argument = self.argument(Operation.VERIFY_TABLE, TABLE)
        return tuple(
            c.name for c in self.dictionary.command(self.command(Operation.VERIFY_TABLE)).argument(argument).choices
        )


def _comparable(argument: Argument, value: Value) -> Value:
    """Return an enumeration value as its name, bytes in hexadecimal without zeros at the end, and other values unchanged."""
    if argument.choices and isinstance(value, int):
        return argument.choice_name(value) or value
    if argument.type in ("bytes", "rest"):
        return (value.hex() if isinstance(value, bytes) else str(value)).replace(" ", "").lower().rstrip("0")
    return value


def absence(operation: Operation) -> str:
    """Return a sentence that states that a sensor lacks an operation."""
    if operation in CANNOT:
        return f"This sensor cannot {CANNOT[operation]}."
    return f"This sensor has no command to {operation.value.replace('_', ' ')}."


def check_operation(
    operation: Operation, row: OperationRow, dictionary: Dictionary
) -> tuple[tuple[str, ...], str] | None:
    """Return path and reason of the first error in the row; None if the row fits the dictionary."""
    if (row.transfer is not None) != (operation in TRANSFERS):
        return (), "needs a kind of transfer" if operation in TRANSFERS else "needs a command"
    if row.transfer is not None:
        return None
    commands = {c.name: c for c in dictionary.commands}
    if row.command not in commands:
        return ("command",), f"the dictionary has no command {row.command}"
    standard = ARGUMENTS.get(operation, ())
    for name in row.arguments:
        if name not in standard:
            return ("arguments", name), f"the operation has no such argument; it has {', '.join(standard) or 'none'}"
    command = commands[row.command or ""]
    names = {argument.name: argument for argument in command.arguments}
    for name, mapped in row.arguments.items():
        if mapped.name not in names:
            return ("arguments", name), f"{command.name} has no argument {mapped.name}"
    for name in row.fixed:
        if name not in names:
            return ("fixed", name), f"{command.name} has no argument {name}"
        try:
            check_argument(names[name], row.fixed[name])
        except BadInput as error:
            return ("fixed", name), str(error)
    return None
