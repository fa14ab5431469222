"""The plan of a session: everything that is decided before the first prompt.

It is the journal's header, so a journal alone is enough to resume the session or to make its calibration files again.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import tiltcal
from tiltcal.bench.device_setup import DeviceSetup, all_virtual, devices_of, with_thermometer
from tiltcal.calibration.suitability import require_suitable
from tiltcal.drivers.bus.clock import VIRTUAL_START
from tiltcal.errors import InputError, JournalError, UsageError
from tiltcal.files.base_calibration import BaseFile
from tiltcal.files.bench import BenchFile
from tiltcal.files.journal import Journal
from tiltcal.files.journal_header import Header, SessionSettings
from tiltcal.files.moments import stamp
from tiltcal.files.procedure import Procedure
from tiltcal.files.procedure_file import find_procedure, procedure_from_record, shipped_procedures
from tiltcal.stated_arguments import require_printable

if TYPE_CHECKING:
    from tiltcal.bench.channel_map import ChannelMap
    from tiltcal.files.rotation import Rotation


@dataclass(frozen=True)
class SessionPlan:
    """Everything that is decided before the first prompt.

    Attributes
    ----------
    operator : str
        Who sets the positions: ``terminal``, ``json`` or ``sim``.
    person : str or None
        Who stands at the bench.
    started : datetime
        UTC.
    journal : str
        The journal's file name.
    bases : mapping of str to BaseFile
        The calibrations that the sensors have already, by serial number.
    typical : bool
        Whether the model's mean temperature curves stand in for a run of the unit's own.
    """

    procedure: Procedure
    sensors: tuple[DeviceSetup, ...]
    settings: SessionSettings
    operator: str
    person: str | None
    started: datetime
    software: str
    journal: str
    thermometer: DeviceSetup | None = None
    bases: Mapping[str, BaseFile] = field(default_factory=dict)
    typical: bool = False

    @property
    def devices(self) -> tuple[DeviceSetup, ...]:
        """The sensors, and the thermometer behind them; a journal numbers them in this order."""
        return with_thermometer(self.sensors, self.thermometer)

    @property
    def virtual(self) -> bool:
        """Whether every device is a virtual twin; the clock is virtual then too."""
        return all_virtual(self.devices)

    def channel_map(self, rotation: Rotation) -> ChannelMap:
        """Return which readings of the sensors are the channels of a turning stage.

        A UsageError where there is no stage angle, or not one pair has its channels.
        """
        from tiltcal.bench.channel_map import map_channels

        return map_channels(rotation, [(device.serial, device.model) for device in self.sensors])

    def require_as_begun(self, stated: Mapping[str, object]) -> None:
        """Refuse to continue the session with other settings than it began with.

        ``stated`` are values by option; None and False of those that are not stated. `--bench` is a BenchFile; a
        procedure is a shipped one's name or the path of your own. A UsageError where one differs.
        """
        procedure, settings = self.procedure, self.settings
        begun = {
            "--sensor": ", ".join(device.model_name for device in self.sensors),
            "--address": ", ".join(device.address for device in self.sensors),
            "--serial": ", ".join(device.serial for device in self.sensors),
            "--base": dict(self.bases),
            "--journal": self.journal,
            "--samples": settings.samples,
            "--settle": settings.settle,
            "--jig": settings.jig,
            "--table-lean": settings.table,
            "--heading-uncertainty": settings.heading,
            "--tilt": settings.angle,
            "--turns": settings.turns,
            "--alignment": procedure.alignment,
            "--typical-temperature": self.typical,
            "--closing": procedure.closes,
        }
        for option, value in stated.items():
            if value is None or value is False:
                continue
            differs, where = option in begun and value != begun[option], ""
            if isinstance(value, BenchFile):
                where = "".join(f" in its {key}" for key in self._differences(value, stated)[:1])
            elif option in ("PROCEDURE", "--procedure"):
                differs = not self._begins_as(str(value))
            if differs or where:
                raise UsageError(
                    f"{option} differs{where} from what the session of {self.journal} began with: leave it out"
                )

    def _differences(self, bench: BenchFile, stated: Mapping[str, object]) -> list[str]:
        """Return the keys of a bench file that this session did not begin with, but for what an option replaces."""
        sensors, thermometer = devices_of(bench)
        uncertainty = None if bench.thermometer is None else bench.thermometer.uncertainty
        settings = self.settings
        keys = {
            "sensors": sensors == tuple(replace(device, output="") for device in self.sensors),
            "thermometer": (thermometer, uncertainty) == (self.thermometer, settings.thermometer),
            "jig": stated["--jig"] is not None or bench.jig == settings.jig,
            "table": stated["--table-lean"] is not None or bench.table == settings.table,
            "heading": stated["--heading-uncertainty"] is not None or bench.heading == settings.heading,
        }
        return [key for key, same in keys.items() if not same]

    def _begins_as(self, named: str) -> bool:
        """Return whether a procedure of this name, with the settings of this one, is this one."""
        begun = self.procedure
        if named in shipped_procedures():
            return named == begun.name
        found = find_procedure(named, begun.angle)
        if (found.name, found.determines) != (begun.name, begun.determines):
            return False
        found = found.with_turns(None if begun.rotation is None else begun.rotation.turns)
        found = found.with_alignment(begun.alignment if begun.determines.level else None)
        return begun == found.with_closing(begun.closes)

    def header(self) -> Header:
        """Return the header of the session's journal."""
        return Header(
            software=self.software,
            journal=self.journal,
            started=stamp(self.started),
            virtual=self.virtual,
            operator=self.operator,
            person=self.person,
            sensors=tuple(device.header() for device in self.sensors),
            thermometer=None if self.thermometer is None else self.thermometer.header(),
            settings=self.settings,
            procedure=dict(self.procedure.record),
            bases=self.bases,
            typical_temperature=self.typical,
        )

    @classmethod
    def from_journal(cls, journal: Journal) -> SessionPlan:
        """Read the plan of a captured session from its journal; a JournalError where the header lacks something."""
        header = journal.plan()
        try:
            angle, file = header.settings.angle, str(journal.path)
            procedure = procedure_from_record(header.procedure, angle, file=file, line=1)
            missing = [sensor.serial for sensor in header.sensors if sensor.serial not in header.known]
            if procedure.determines.completes and missing:
                raise UsageError(
                    f"{procedure.name} completes the calibration that a sensor has, and none of "
                    f"{', '.join(missing)} is in the journal: measure anew"
                )
            return cls(
                procedure=procedure.with_turns(header.settings.turns),
                sensors=tuple(DeviceSetup.from_header(sensor) for sensor in header.sensors),
                settings=header.settings,
                operator=header.operator,
                person=header.person,
                started=datetime.fromisoformat(header.started),
                software=header.software,
                journal=header.journal,
                thermometer=None if header.thermometer is None else DeviceSetup.from_header(header.thermometer),
                bases=header.known,
                typical=header.typical_temperature,
            )
        except (ValueError, InputError, UsageError) as error:
            raise JournalError(f"the header cannot be used: {error}", file=journal.path, line=1) from None


def plan_session(
    procedure: Procedure,
    bench: BenchFile,
    outputs: Sequence[Path | None],
    journal: Path,
    *,
    operator: str,
    samples: int | None = None,
    settle: float | None = None,
    bases: Mapping[str, BaseFile] | None = None,
    typical: bool = False,
) -> SessionPlan:
    """Return the plan of a session, from the options of the command line and the bench file.

    ``outputs`` are the calibration files, one per sensor; None where none is made. ``samples`` and ``settle`` take the
    place of the procedure's; the soaking window is scaled with ``settle``. A UsageError on an unknown model, a bad
    address, or an angle that the model cannot read.
    """
    scale = 1.0 if settle is None else settle / procedure.settle
    for path in filter(None, (journal, *outputs)):
        require_printable(str(path), "the name of a file")
    sensors, thermometer = devices_of(bench)
    plan = SessionPlan(
        procedure=procedure,
        sensors=tuple(
            replace(sensor, output="" if output is None else os.path.relpath(output, journal.parent))
            for sensor, output in zip(sensors, outputs, strict=True)
        ),
        settings=SessionSettings(
            samples=samples or procedure.samples,
            settle=settle or procedure.settle,
            soak=procedure.soak.seconds * scale,
            jig=bench.jig,
            thermometer=None if bench.thermometer is None else bench.thermometer.uncertainty,
            table=bench.table,
            heading=bench.heading,
            angle=procedure.angle,
            turns=None if procedure.rotation is None else procedure.rotation.turns,
        ),
        operator=operator,
        person=bench.operator,
        started=VIRTUAL_START,
        software=f"tiltcal {tiltcal.__version__}",
        journal=journal.name,
        thermometer=thermometer,
        bases=bases or {},
        typical=typical,
    )
    if procedure.rotation is not None:
        plan.channel_map(procedure.rotation)
    else:
        for device in plan.sensors:
            require_suitable(procedure, device.model, device.orientation, based=device.serial in plan.bases)
    if typical:
        _require_population(plan)
    return plan if plan.virtual else replace(plan, started=_to_the_millisecond(datetime.now(UTC)))


def _require_population(plan: SessionPlan) -> None:
    """Refuse mean temperature curves that have no source, or that the procedure measures itself."""
    determines = plan.procedure.determines
    if plan.procedure.rotation is not None:
        raise UsageError(f"{plan.procedure.name} needs no --typical-temperature: a pair has no temperature terms")
    if determines.drift or determines.gain or determines.completes:
        raise UsageError(
            f"{plan.procedure.name} needs no --typical-temperature: it has no temperature terms, or measures them"
        )
    for device in plan.sensors:
        if device.model.population is None:
            raise UsageError(
                f"no source states how a {device.model_name} behaves over temperature on average: measure it"
            )


def _to_the_millisecond(moment: datetime) -> datetime:
    """Return the moment as a time stamp holds it, so that a replay counts from the same instant."""
    return moment.replace(microsecond=moment.microsecond // 1000 * 1000)
