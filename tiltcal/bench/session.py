"""One session at the bench: what is measured, how it is captured, and the calibration files that come of it.

A :class:`Plan` says everything that is decided before the first prompt. It is the journal's header, so a journal alone
is enough to resume the session or to make its calibration files again.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import tiltcal
from tiltcal.bench.bay import Bay
from tiltcal.bench.operators.operator import Operator
from tiltcal.bench.runner import Runner, Settings, Taken
from tiltcal.bench.tape import Tape, TapedClock
from tiltcal.bench.virtual import VirtualBench
from tiltcal.calibrate import Measurement, Nominal, calibrate
from tiltcal.drivers import find_model
from tiltcal.drivers.bus import link_letter, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import Clock, SystemClock, VirtualClock
from tiltcal.drivers.bus.link import Link
from tiltcal.drivers.device import Model, Talking
from tiltcal.errors import JournalError, UsageError
from tiltcal.files.calibration import Calibration, dump_calibration
from tiltcal.files.journal import Journal, JournalWriter
from tiltcal.files.procedure import Procedure, procedure_from_record
from tiltcal.files.whole import check_writable, write_whole

VIRTUAL_START = datetime(2000, 1, 1, tzinfo=UTC)
"""When every session on the virtual bench starts, so that the same seed gives the same file to the byte."""


@dataclass(frozen=True)
class Place:
    """One sensor of a plan.

    Attributes
    ----------
    model, serial, address : str
    output : str
        The calibration file, relative to the journal's folder.
    """

    model: str
    serial: str
    address: str
    output: str

    @property
    def fitted(self) -> Model:
        """The model as it is wired at the address."""
        return find_model(self.model).at(parse_address(self.address))


@dataclass(frozen=True)
class Plan:
    """Everything that is decided before the first prompt.

    Attributes
    ----------
    procedure : Procedure
    places : tuple of Place
    settings : Settings
    jig : float or None
        Standard uncertainty of a set angle, degrees.
    operator : str
        Who leads: ``terminal``, ``json`` or ``sim``.
    started : datetime
        UTC.
    software : str
    journal : str
        The journal's file name.
    """

    procedure: Procedure
    places: tuple[Place, ...]
    settings: Settings
    jig: float | None
    operator: str
    started: datetime
    software: str
    journal: str

    @property
    def virtual(self) -> bool:
        """Whether every sensor is a virtual twin; the clock is virtual then too."""
        return all(parse_address(place.address).simulated for place in self.places)

    def header(self) -> dict[str, Any]:
        """As plain data, for the journal."""
        return {
            "software": self.software,
            "journal": self.journal,
            "started": _stamp(self.started),
            "virtual": self.virtual,
            "operator": self.operator,
            "sensors": [
                {"model": p.model, "serial": p.serial, "address": p.address, "output": p.output} for p in self.places
            ],
            "settings": {
                "samples": self.settings.samples,
                "settle": self.settings.settle,
                "soak": self.settings.soak,
                "jig": self.jig,
                "angle": self.procedure.angle,
            },
            "procedure": dict(self.procedure.record),
        }

    @classmethod
    def from_journal(cls, journal: Journal) -> Plan:
        """The plan of a captured session.

        Raises
        ------
        JournalError
            The header lacks something.
        """
        header = journal.header
        try:
            settings = header["settings"]
            return cls(
                procedure=procedure_from_record(header["procedure"], settings["angle"], file=str(journal.path), line=1),
                places=tuple(Place(**sensor) for sensor in header["sensors"]),
                settings=Settings(settings["samples"], settings["settle"], settings["soak"]),
                jig=settings["jig"],
                operator=header["operator"],
                started=datetime.fromisoformat(header["started"]),
                software=header["software"],
                journal=header["journal"],
            )
        except (KeyError, TypeError, ValueError) as error:
            raise JournalError(f"the header cannot be used: {error}", file=journal.path, line=1) from None


def plan_session(
    procedure: Procedure,
    places: Sequence[tuple[str, str, str, Path]],
    journal: Path,
    *,
    operator: str,
    samples: int | None = None,
    settle: float | None = None,
    jig: float | None = None,
) -> Plan:
    """Lay down a session from what the command line says.

    Parameters
    ----------
    procedure : Procedure
    places : sequence of (model, serial, address, output)
    journal : Path
    operator : str
    samples, settle, jig
        In place of the procedure's; the soaking window is scaled with ``settle``.

    Raises
    ------
    UsageError
        An unknown model, a bad address, or an angle that the model cannot read.
    """
    scale = 1.0 if settle is None else settle / procedure.settle
    virtual = all(parse_address(address).simulated for _, _, address, _ in places)
    for name, _, address, _ in places:
        _require_in_range(procedure, find_model(name).at(parse_address(address)))
    return Plan(
        procedure=procedure,
        places=tuple(
            Place(model, serial, address, os.path.relpath(output, journal.parent))
            for model, serial, address, output in places
        ),
        settings=Settings(samples or procedure.samples, settle or procedure.settle, procedure.soak_seconds * scale),
        jig=jig,
        operator=operator,
        started=VIRTUAL_START if virtual else _to_the_millisecond(datetime.now(UTC)),
        software=f"tiltcal {tiltcal.__version__}",
        journal=journal.name,
    )


class Session:
    """A plan being carried out, live, resumed or replayed.

    Parameters
    ----------
    plan : Plan
    path : Path
        The journal.
    journal : Journal, optional
        What was captured before.

    Attributes
    ----------
    receptions : dict of str to mapping of str to int
        By serial number, once the session is through: what became of what a sensor said that talks by itself.
    """

    def __init__(self, plan: Plan, path: Path, journal: Journal | None = None) -> None:
        self.receptions: dict[str, Mapping[str, int]] = {}
        self.plan = plan
        self.path = path
        self._journal = journal
        self._clock: Clock = VirtualClock() if plan.virtual else SystemClock(int(plan.started.timestamp() * 1e9))
        self._virtual = VirtualBench(self._clock, [parse_address(p.address) for p in plan.places], self.models.values())

    @property
    def outputs(self) -> list[Path]:
        """Where the calibration files go, one per sensor."""
        return [Path(os.path.normpath(self.path.parent / place.output)) for place in self.plan.places]

    @property
    def models(self) -> dict[str, Model]:
        """The model of each sensor, by serial number."""
        return {place.serial: place.fitted for place in self.plan.places}

    def preflight(self) -> None:
        """Before the operator starts: the files can be written, and every sensor answers.

        Raises
        ------
        UsageError
            A path that cannot be written.
        HardwareError
            A sensor that does not answer.
        """
        for path in (*self.outputs, self.path):
            check_writable(path)
        for number, place in enumerate(self.plan.places):
            with closing(self._open(number)) as link:
                place.fitted.driver(link, self._clock).probe()
        self._clock.seek(0)

    def measure(self, operator: Operator) -> list[Path]:
        """Carry the session out, or go on with it, and write the calibration files.

        Returns
        -------
        list of Path
            The files that were written.

        Raises
        ------
        TiltcalError
            What stopped it; everything that was measured is in the journal.
        """
        writer = None
        if self._journal is None:
            writer = JournalWriter.create(self.path, self.plan.header())
        elif self._journal.end is None:
            writer = JournalWriter.resume(self._journal)
        try:
            texts = self._run(operator, writer)
        finally:
            if writer is not None:
                writer.close()
        for path, text in zip(self.outputs, texts, strict=True):
            write_whole(path, text)
        operator.done(self.outputs, self.path)
        return self.outputs

    def replay(self, operator: Operator) -> list[str]:
        """Run a captured session again without hardware; the texts of its calibration files.

        Raises
        ------
        JournalError
            The journal does not fit, or ends before the session did.
        """
        return self._run(operator, None)

    def _run(self, operator: Operator, writer: JournalWriter | None) -> list[str]:
        """Walk through the procedure and make the calibration files' texts."""
        tape = Tape(self._clock, self._journal, writer)
        clock = TapedClock(tape, self._clock)
        links = [
            tape.link(partial(self._open, number), link_letter(parse_address(place.address), place.fitted), number)
            for number, place in enumerate(self.plan.places)
        ]
        bays = [
            Bay(place.fitted, place.serial, place.fitted.driver(link, clock))
            for place, link in zip(self.plan.places, links, strict=True)
        ]
        fixture = self._virtual.fixture if self.plan.virtual and writer is not None else None
        runner = Runner(self.plan.procedure, bays, operator, tape, clock, self.plan.settings, fixture)
        try:
            taken = runner.run()
            calibrations = [self._calibration(bay, number, taken) for number, bay in enumerate(bays)]
            runner.confirm_write(lambda: operator.write(self.outputs))
            ended = self.plan.started + timedelta(microseconds=tape.now_ns() / 1000)
            sha256 = tape.finish()
            self.receptions = {b.serial: b.sensor.reception() for b in bays if isinstance(b.sensor, Talking)}
        finally:
            for link in links:
                link.close()
        return [
            dump_calibration(replace(calibration, provenance=self._provenance(place, ended, sha256)))
            for calibration, place in zip(calibrations, self.plan.places, strict=True)
        ]

    def _open(self, number: int) -> Link:
        """The live link of one sensor."""
        place = self.plan.places[number]
        address, model = parse_address(place.address), place.fitted
        return self._virtual.twin(address, model) if address.simulated else open_link(address, model)

    def _calibration(self, bay: Bay, number: int, taken: Sequence[Taken]) -> Calibration:
        """The calibration of one sensor, without its provenance."""
        measurements = [
            Measurement(
                one.position.name,
                one.position.gravity,
                one.position.tilt,
                one.temperatures[number],
                one.summaries[number],
                {"time": _stamp(self.plan.started + timedelta(microseconds=one.time_ns / 1000))},
            )
            for one in taken
        ]
        settings = self.plan.settings
        return calibrate(
            bay.identity,
            self.plan.procedure,
            measurements,
            nominal=Nominal(
                bay.model.sensitivity, bay.model.sensitivity * bay.model.sensitivity_spread, bay.model.rails
            ),
            jig=self.plan.jig,
            settings={"samples": settings.samples, "settle_seconds": settings.settle},
        )

    def _provenance(self, place: Place, ended: datetime, sha256: str) -> dict[str, Any]:
        return {
            "made_by": "the virtual bench: no real sensor was measured" if self.plan.virtual else "measurement",
            "operator": self.plan.operator,
            "bench": {"address": place.address},
            "software": self.plan.software,
            "started": _stamp(self.plan.started),
            "ended": _stamp(ended),
            "journal": {"name": self.plan.journal, "sha256": sha256},
            **({"reception": dict(self.receptions[place.serial])} if place.serial in self.receptions else {}),
        }


def _require_in_range(procedure: Procedure, model: Model) -> None:
    """Refuse positions that the model can only answer with its rail, and a scale that nobody has stated."""
    if not model.scaled and not procedure.determines.axes:
        raise UsageError(
            f"{procedure.name} determines no sensitivity, and that of {model.name} is not known: state it in the "
            "address (sensitivity=..., unit per g)"
        )
    for position in procedure.positions:
        for channel in model.channels:
            expected = model.offset + model.sensitivity * position.gravity["xyz".index(channel)]
            if not model.rails[0] < expected < model.rails[1]:
                hint = "; a smaller --tilt brings it in range" if procedure.angle is not None else ""
                raise UsageError(
                    f"position {position.name} is outside the range of {model.name}: {channel} would read about "
                    f"{expected:.5g} {model.unit}, between {model.rails[0]:g} and {model.rails[1]:g} it can{hint}"
                )


def _to_the_millisecond(moment: datetime) -> datetime:
    """What a stamp can hold, so that a replay counts from the same instant."""
    return moment.replace(microsecond=moment.microsecond // 1000 * 1000)


def _stamp(moment: datetime) -> str:
    """ISO 8601, UTC, to the millisecond."""
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
