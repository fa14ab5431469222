"""The setup of a new session: the bench file with its models and addresses, and the first line of the journal."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import tiltcal
from tiltcal.bench.machines import require_reachable
from tiltcal.bench.reference import reference_of
from tiltcal.drivers.bus.clock import VIRTUAL_START
from tiltcal.errors import Argument, UsageError
from tiltcal.files.bench import BenchFile, BenchSensor, bench_of, with_device_file
from tiltcal.files.calibration import BaseFile, SensorIdentity
from tiltcal.files.device import DeviceFile
from tiltcal.files.document import Document
from tiltcal.files.moments import stamp
from tiltcal.files.procedure import Procedure, Rotation
from tiltcal.files.record import plain
from tiltcal.journal.header import TYPICAL, BenchDevice, Settings, Setup, thermometer_of
from tiltcal.stated_arguments import require_printable


def require_trusted(content: object, file: str | Path, trusted: str | None) -> None:
    """Refuse a file that would import modules of Python which nobody named.

    ``trusted`` has their names, with commas between them.

    UsageError: the addresses of a bench file or a journal name others.
    """
    named = set(re.findall(r'(?i)"address":"\s*python:([^:"]*)', json.dumps(plain(content), separators=(",", ":"))))
    if strange := named - set((trusted or "").split(",")):
        names = ", ".join(sorted(strange))
        raise UsageError(
            f"{file} names {names}, a module of Python that would be imported here and then does what it likes",
            advice=("if you trust it, say ", Argument("python", ",".join(sorted(named)))),
        )


def known_bench(document: Document) -> BenchFile:
    """Return the bench of a document, whose models are known and addresses right; an InputError where one is not."""
    bench = bench_of(document)
    for number, sensor in enumerate(bench.sensors):
        with document.locating("sensors", number):
            _ = sensor.wired
    with document.locating("thermometer"):
        thermometer_of(bench)
    for name, machine in (("table", bench.table), ("chamber", bench.chamber)):
        if machine is not None:
            from tiltcal.bench.drives import check_addresses

            with document.locating(name):
                check_addresses(machine)
    return bench


def single(model: str, serial: str, address: str, device: DeviceFile | None = None) -> BenchFile:
    """Return a bench of one sensor, which needs no file but that of a text device."""
    require_printable(serial, "the serial number")
    return BenchFile((with_device_file(BenchSensor(serial, model, address, device=device)),))


def free_journal(output: Path, remark: Callable[[str], None]) -> Path:
    """Return a journal's name beside the calibration file; an earlier session's journal is never touched."""
    path = output.with_name(f"{output.stem}.journal.jsonl")
    number = 2
    while os.path.exists(path):
        path = output.with_name(f"{output.stem}.{number}.journal.jsonl")
        number += 1
    if number > 2:
        remark(f"an earlier journal is kept; this session is recorded in {path}")
    return path


def new_setup(
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
    angles: str | None = None,
) -> Setup:
    """Return the setup of a new session.

    ``outputs`` are the calibration files, one per sensor; None where none is made. ``samples`` and ``settle`` take
    the place of the procedure's; the soaking window is scaled with ``settle``.

    UsageError: an unknown model, a bad address, or an angle that the model cannot read.
    """
    for path in filter(None, (journal, *outputs)):
        require_printable(str(path), "the name of a file")
    sensors = tuple(
        BenchDevice(
            model=sensor.model,
            serial=sensor.serial,
            address=sensor.address,
            axes=sensor.orientation.names,
            device=sensor.device,
            output="" if output is None else os.path.relpath(output, journal.parent),
        )
        for sensor, output in zip(bench.sensors, outputs, strict=True)
    )
    thermometer, reference = thermometer_of(bench), reference_of(bench)
    virtual = all(device.simulated for device in (*sensors, *filter(None, (thermometer, reference))))
    setup = Setup(
        software=f"tiltcal {tiltcal.__version__}",
        journal=journal.name,
        started=stamp(VIRTUAL_START if virtual else datetime.now(UTC)),
        virtual=virtual,
        operator=operator,
        person=bench.operator,
        sensors=sensors,
        thermometer=thermometer,
        reference=reference,
        table=bench.table,
        chamber=bench.chamber,
        references=bench.references,
        settings=_settings(procedure, bench, samples, settle).replaced(angles=angles),
        procedure=dict(procedure.record),
        bases=bases or {},
        typical_temperature=typical,
    )
    _require_suitable(setup)
    return setup


def _require_suitable(setup: Setup) -> None:
    """Refuse a procedure that the devices cannot carry out, and curves that have no source or are measured."""
    steps = setup.steps
    if steps.compares and setup.reference is None:
        raise UsageError(f"{steps.name} states no angles: the bench file needs a reference, which reads them")
    if setup.reference is not None and not steps.takes_reference:
        raise UsageError(f"{steps.name} sets no angles that a reference could read: take it out of the bench file")
    if isinstance(steps, Rotation):
        setup.stage_channels()
    else:
        from tiltcal.calibration.angle_units import identified
        from tiltcal.calibration.measurement import require_suitable

        if setup.machines:
            require_reachable(setup.machines, steps.positions)
        for device in setup.sensors:
            require_suitable(steps.in_positions(), model := device.wired, device.orientation)
            identity = SensorIdentity(model.name, device.serial, model.unit, model.channels)
            identified(identity, steps.in_positions(), setup.settings.angles)
    if not setup.typical_temperature:
        return
    if steps.without_typical:
        raise UsageError((f"{steps.name} needs no ", TYPICAL, f": {steps.without_typical}"))
    for device in setup.sensors:
        if device.wired.population is None:
            raise UsageError(f"no source states how a {device.model} behaves over temperature on average: measure it")


def _settings(procedure: Procedure, bench: BenchFile, samples: int | None, settle: float | None) -> Settings:
    """Return the settings of a procedure at a bench, with samples and seconds that are stated in place of its own."""
    settings = Settings(
        jig=bench.jig,
        thermometer=None if bench.thermometer is None else bench.thermometer.uncertainty,
        table_lean=bench.table_lean,
        heading=bench.heading,
    )
    if isinstance(procedure, Rotation):
        return settings.replaced(turns=procedure.turns)
    steps = procedure.in_positions()
    held = settle or steps.settle
    soak = steps.soak.seconds * (held / steps.settle)
    return settings.replaced(samples=samples or steps.samples, settle=held, soak=soak, angle=steps.angle)
