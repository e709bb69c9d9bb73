"""Store of ground stations: check, add, change and delete them."""

from __future__ import annotations

from dataclasses import replace

from gss.device.line_address import parse_line_address
from gss.domain.errors import BadInput, Conflict
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.orbit.station import GroundStation, checked_station
from gss.store import passes as store
from gss.store.engine import Database
from gss.store.models import Station

MAX_STATIONS = 50


class StationService:
    """Stores ground stations. :class:`Station` describes ``line_url`` and ``line_baud``."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now

    def list_all(self) -> list[Station]:
        """Return all stations, sorted by name."""
        with self._database.unit_of_work() as session:
            return store.list_stations(session)

    def get(self, station_id: int) -> Station:
        """Return the station with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get_station(session, station_id)

    def create(self, station: GroundStation, line_url: str, line_baud: int, note: str, *, user: str) -> Station:
        """Store a new station. Raises BadInput that names the invalid value, Conflict if the name is already used."""
        checked, url = _named(checked_station(station)), checked_url(line_url)
        with self._database.unit_of_work() as session:
            self._check_name(store.station_named(session, checked.name), None)
            if len(store.list_stations(session)) >= MAX_STATIONS:
                raise Conflict("too many ground stations", expected=f"at most {MAX_STATIONS}", hint="Delete one.")
            row = Station(
                name=checked.name, line_url=url, line_baud=line_baud, note=note, user=user, changed=self._now()
            )
            _set_position(row, checked)
            store.add(session, row)
        self._bus.record("pass", "ok", f"{user} added the ground station {row.name}")
        return row

    def change(
        self, station_id: int, station: GroundStation, line_url: str, line_baud: int, note: str, *, user: str
    ) -> Station:
        """Replace all values of a station. Raises NotFound, and BadInput and Conflict as :meth:`create` does."""
        checked, url = _named(checked_station(station)), checked_url(line_url)
        with self._database.unit_of_work() as session:
            row = store.get_station(session, station_id)
            self._check_name(store.station_named(session, checked.name), row)
            row.name, row.line_url, row.line_baud, row.note = checked.name, url, line_baud, note
            row.user, row.changed = user, self._now()
            _set_position(row, checked)
        self._bus.record("pass", "ok", f"{user} changed the ground station {row.name}")
        return row

    def delete(self, station_id: int, *, user: str) -> None:
        """Delete a station. Raises NotFound."""
        with self._database.unit_of_work() as session:
            name = store.get_station(session, station_id).name
            store.delete_station(session, station_id)
        self._bus.record("pass", "ok", f"{user} deleted the ground station {name}")

    @staticmethod
    def _check_name(same_name: Station | None, same: Station | None) -> None:
        if same_name is not None and (same is None or same_name.id != same.id):
            raise Conflict(
                "a ground station with this name exists",
                got=same_name.name,
                hint="Choose another name, or edit that one.",
            )


def ground_station(row: Station) -> GroundStation:
    """Return a stored station as a GroundStation for calculations."""
    mask = tuple((float(azimuth), float(elevation)) for azimuth, elevation in row.mask)
    return GroundStation(row.name, row.latitude_rad, row.longitude_rad, row.height_m, row.min_elevation_rad, mask)


def checked_url(url: str) -> str:
    """Return the address of a line without spaces around it, "" if it is empty. Raises BadInput if it is not valid."""
    address = url.strip()
    if address:
        parse_line_address(address)
    return address


def _named(station: GroundStation) -> GroundStation:
    name = " ".join(station.name.split())
    if not 0 < len(name) <= 60:
        raise BadInput("the name of the ground station is not valid", expected="1 – 60 characters", got=str(len(name)))
    return replace(station, name=name)


def _set_position(row: Station, station: GroundStation) -> None:
    row.latitude_rad, row.longitude_rad, row.height_m = station.latitude_rad, station.longitude_rad, station.height_m
    row.min_elevation_rad, row.mask = station.min_elevation_rad, [list(point) for point in station.mask]
