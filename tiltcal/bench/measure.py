"""Measuring from Python: what ``tiltcal measure`` does, as a function, and a sensor that can be read by itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import Any

import tiltcal
from tiltcal.bench.device_setup import DeviceSetup, known_bench, single
from tiltcal.bench.operators.selection import open_operator
from tiltcal.bench.sensor_set import open_device
from tiltcal.bench.session import Session, SessionResult
from tiltcal.bench.session_calibration import changes_in_words
from tiltcal.bench.session_plan import SessionPlan, plan_session
from tiltcal.bench.virtual_bench import VirtualBench
from tiltcal.calibration.calibration import Calibration
from tiltcal.calibration.level import NO_LEVEL, level_summary
from tiltcal.calibration.prediction import predict
from tiltcal.calibration.unit_gravity import require_no_jig
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import session_clock
from tiltcal.drivers.device import Sensor, in_words
from tiltcal.errors import JournalError, UsageError
from tiltcal.files.atomic import check_writable
from tiltcal.files.base_calibration import bases_of, identity_in
from tiltcal.files.bench import BenchFile
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.document import read_document
from tiltcal.files.node import require_name
from tiltcal.files.procedure import Procedure
from tiltcal.files.procedure_file import find_procedure
from tiltcal.stated_booleans import require_boolean
from tiltcal.stated_numbers import of_python, require_above_zero, require_from_zero, require_whole
from tiltcal.stated_texts import require_path


def unheard(remark: str) -> None:
    """Drop a remark."""


def measure(
    procedure: str | Path | None = None,
    *,
    operator: object = None,
    sensor: str | None = None,
    address: str | None = None,
    serial: str | None = None,
    output: str | Path | None = None,
    bench: str | Path | BenchFile | None = None,
    samples: int | None = None,
    settle: float | None = None,
    jig: float | None = None,
    table_lean: float | None = None,
    heading: float | None = None,
    tilt: float | None = None,
    turns: int | None = None,
    alignment: float | None = None,
    base: str | Path | None = None,
    typical_temperature: bool = False,
    closing: bool = False,
    journal: str | Path | None = None,
    resume: str | Path | None = None,
    plain: bool = False,
    remark: Callable[[str], None] = unheard,
) -> Calibration | Any:
    """Take sensors through a procedure, and write their calibration files.

    Everything is captured in a journal as it happens. After an interruption the same call with ``resume`` goes on from
    the last byte.

    Parameters
    ----------
    procedure : str or Path
        A shipped procedure by its name, or your own by its path.
    operator : object or str
        Who brings the sensors into position. An object with the methods of :mod:`tiltcal.bench.operators.rig`:
        ``position(ask)`` returns an answer such as ``{"answer": "ready", "tilt": {"y": 30.02}}``; for a turning stage
        ``rotation(ask)``. By name: ``"terminal"``, ``"json"``, ``"sim"``. None: as the journal says, or a terminal.
    sensor, address, serial : str
        Model, address and serial number of one sensor.
    output : str or Path
        The calibration file; with ``bench`` the folder.
    bench : str, Path or BenchFile, optional
        Several sensors at once, in place of the three above.
    samples : int, optional
        Samples per position, in place of the procedure's.
    settle : float, optional
        Seconds that a reading must hold still, in place of the procedure's.
    jig : float, optional
        Standard uncertainty of a set angle, degrees.
    table_lean : float, optional
        Standard uncertainty of the lean of the table that all positions share, degrees per axis.
    heading : float, optional
        Standard uncertainty of a heading, degrees.
    tilt : float, optional
        The angle that the procedure leaves free, degrees.
    turns : int, optional
        The most turns of a stage, in place of the procedure's.
    alignment : float, optional
        With ``level``: by how much at most the sensor may sit askew since its calibration, degrees about each axis.
    base : str or Path, optional
        The sensor's own calibration file, or a folder with SERIAL.yaml of each: a mounting or a new level completes it,
        and its sensitivity stands in where the procedure determines none. A file names model and serial number as well.
    typical_temperature : bool
        Whether the data sheet's mean temperature curves stand in for a temperature run.
    closing : bool
        Whether the first position is visited once more at the end, which shows what has changed meanwhile.
    journal : str or Path, optional
        Where the session is captured; by default beside the output.
    resume : str or Path, optional
        The journal of an interrupted session, to go on with. All but the operator is as at its start, and what is
        stated otherwise is refused; with ``output`` the calibration goes there, which it must where the journal names a
        file outside its own folder.
    plain : bool
        Whether the terminal prints lines only.
    remark : callable
        Gets each remark on the session, one line of text.

    Returns
    -------
    Calibration, PairCalibration or list of Calibration
        Of the sensor, of the pairs of a stage, or of each of several sensors; a type checker cannot know which.

    Raises
    ------
    UsageError, InputError
        What is asked for cannot be done; nothing was measured.
    HardwareError
        A device failed for good, or sensors of a bench were given up.
    Stopped
        The operator stopped; the message says how to go on.
    """
    for option, stated in (("--typical-temperature", typical_temperature), ("--closing", closing), ("--plain", plain)):
        require_boolean(option, stated)
    typical_temperature, closing, plain = map(of_python, (typical_temperature, closing, plain))
    samples, turns = of_python(samples), of_python(turns)
    settle, jig, table_lean, heading, tilt, alignment = map(
        of_python, (settle, jig, table_lean, heading, tilt, alignment)
    )
    for option, file in (("--base", base), ("--journal", journal), ("--resume", resume), ("-o", output)):
        if file is not None:
            require_path(option, file)
    require_from_zero("--heading-uncertainty", heading)
    if resume is not None and os.path.exists(resume):
        session = _resumed(Path(resume), None if output is None else Path(output), remark)
        operator = operator or session.plan.operator
        begun = session.plan
        serials = [device.serial for device in begun.sensors]
        begun.require_as_begun(
            {
                "PROCEDURE": procedure,
                "--sensor": sensor,
                "--address": address,
                "--serial": serial,
                "--bench": None if bench is None else _bench(bench),
                "--base": None if base is None else bases_of(begun.procedure, base, serials),
                "--journal": None if journal is None else Path(journal).name,
                "--samples": samples,
                "--settle": settle,
                "--jig": jig,
                "--table-lean": table_lean,
                "--heading-uncertainty": heading,
                "--tilt": tilt,
                "--turns": turns,
                "--alignment": alignment,
                "--typical-temperature": typical_temperature,
                "--closing": closing,
            }
        )
    else:
        operator = operator or "terminal"
        if base is not None and bench is None and os.path.isfile(base):
            identity = identity_in(base)
            sensor, serial = sensor or identity.model, serial or identity.serial
        _require_named(
            procedure, bench, resume, {"--sensor": sensor, "--address": address, "--serial": serial, "-o": output}
        )
        steps = find_procedure(str(procedure), tilt)
        steps = steps.with_turns(turns).with_alignment(alignment).with_closing(closing)
        if bench is None:
            require_name(str(serial), "the serial number")
        _require_settings(steps, samples, settle, jig)
        sensors = _bench(bench) if bench is not None else single(str(sensor), str(serial), str(address))
        sensors = replace(
            sensors,
            jig=sensors.jig if jig is None else jig,
            table=sensors.table if table_lean is None else table_lean,
            heading=sensors.heading if heading is None else heading,
        )
        bases = bases_of(steps, base, [connected.serial for connected in sensors.sensors])
        outputs, beside = _outputs(steps, sensors, bench, None if output is None else Path(output))
        path = Path(resume or journal or free_journal(beside, remark))
        plan = plan_session(
            steps,
            sensors,
            outputs,
            path,
            operator=operator if isinstance(operator, str) else "json",
            samples=samples,
            settle=settle,
            bases=bases,
            typical=typical_temperature,
        )
        session = Session(plan, path)
        _predict(plan, remark)
    session.require_writable()
    turning = session.plan.procedure.rotation is not None
    with session.resumable("measure", remark):
        session.probe()
        with open_operator(operator, turns=turning, virtual=session.plan.virtual, say=remark, plain=plain) as opened:
            result = session.run(opened)
            result.write()
            opened.done(list(result.calibrations), session.path)
            result.require_all()
    return _results(session, result, remark)


def _remark_notes(calibrations: Sequence[Calibration], remark: Callable[[str], None], *, renewed: bool) -> None:
    """Remark each note once, with its sensors; after ``level``, not again those of the calibration before."""
    having: dict[str, list[str]] = {}
    for calibration in calibrations:
        for note in calibration.fit.notes:
            if not renewed or note == NO_LEVEL:
                having.setdefault(note, []).append(calibration.sensor.serial)
    for note, serials in having.items():
        every = len(serials) == len(calibrations) > 1
        remark(f"{'all sensors' if every else ', '.join(serials)}: {note}")


@contextmanager
def open_sensor(model: str, address: str) -> Iterator[Sensor]:
    """Open one sensor to be read, and close it at the end of the block.

    Parameters
    ----------
    model : str
        Such as ``sca100t-d02``.
    address : str
        Such as ``spi:///dev/spidev0.0``, or ``sim:`` for its virtual twin.

    Yields
    ------
    Sensor
        ``read()`` returns a reading: ``values`` by the model's channels in its unit, ``temperature`` in °C or None.

    Raises
    ------
    UsageError
        No such model, or a bad address.
    HardwareError
        It cannot be opened.
    """
    device = DeviceSetup(model, "", address)
    clock = session_clock(datetime.now(UTC), virtual=parse_address(address).simulated)
    with closing(open_device(device, VirtualBench(clock, [device]))) as link:
        yield device.model.driver(link, clock)


def _resumed(journal: Path, output: Path | None, remark: Callable[[str], None]) -> Session:
    """Return the session of a journal, whose one calibration goes to ``output`` where that is named."""
    session = Session.of_journal(journal, remark, output)
    if not session.outputs:
        raise UsageError(
            f"{journal} is of a verification; continue it with: tiltcal verify CAL --resume {quote(str(journal))}"
        )
    if len(session.outputs) > 1 and output is not None and not os.path.isdir(output):
        raise UsageError(f"the session has {len(session.outputs)} sensors: name a folder instead of {output}")
    return session


def _results(
    session: Session, result: SessionResult, remark: Callable[[str], None]
) -> Calibration | tiltcal.PairCalibration | list[Calibration]:
    """Return what a session found, and remark what limits it."""
    for name, statistics in result.ending.link_statistics_by_serial.items():
        remark(f"{name}: {in_words(statistics)}")
    found = list(result.calibrations.values())
    if session.plan.procedure.rotation is not None:
        return tiltcal.PairCalibration(found[0])  # type: ignore[arg-type]
    calibrations = [Calibration(record) for record in found if isinstance(record, CalibrationRecord)]
    _remark_notes(calibrations, remark, renewed=session.plan.procedure.determines.level)
    for calibration in calibrations:
        if session.plan.procedure.determines.level:
            remark(level_summary(calibration.record))
        if session.plan.procedure.closes:
            remark(changes_in_words(calibration.record))
    return calibrations[0] if len(session.plan.sensors) == 1 else calibrations


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


def _require_named(procedure: object, bench: object, resume: object, single: Mapping[str, object]) -> None:
    """Refuse a session whose procedure or sensor is not named."""
    wanted = {"PROCEDURE": procedure, **(single if bench is None else {})}
    missing = [name for name, value in wanted.items() if value is None]
    if resume is not None and missing:
        raise JournalError("no such journal", file=str(resume))
    if missing:
        raise UsageError(f"measure needs {', '.join(missing)} (or --resume JOURNAL); see tiltcal measure --help")
    if bench is not None and any(value for name, value in single.items() if name != "-o"):
        raise UsageError("the --bench file names the sensors: leave --sensor, --address and --serial out")


def _bench(bench: str | Path | BenchFile) -> BenchFile:
    return bench if isinstance(bench, BenchFile) else known_bench(read_document(bench))


def _predict(plan: SessionPlan, remark: Callable[[str], None]) -> None:
    """Remark how well the positions will determine the coefficients; refuse those that cannot."""
    if plan.procedure.determines.completes:
        return
    if plan.procedure.rotation is not None:
        for why in plan.channel_map(plan.procedure.rotation).left_out:
            remark(why)
        if len(plan.sensors) > 1:
            remark("several devices are read one after the other: the delay of one, times 2 pi f, goes into q")
        return
    for device in {(sensor.model_name, sensor.orientation): sensor for sensor in plan.sensors}.values():
        base = plan.bases.get(device.serial)
        expected = predict(
            plan.procedure,
            device.model,
            jig=plan.jig,
            thermometer=plan.thermometer_uncertainty,
            table_lean=plan.table,
            samples=plan.settings.samples,
            orientation=device.orientation,
            sensors=len(plan.sensors),
            base=None if base is None else base.calibration,
        )
        remark(f"{device.model_name}, {expected}")


def _require_settings(procedure: Procedure, samples: int | None, settle: float | None, jig: float | None) -> None:
    """Refuse settings that the procedure does not have, or with which no session can measure."""
    require_no_jig(procedure, jig)
    require_whole("--samples", samples, 2, "samples")
    require_above_zero("--settle", settle)
    if procedure.rotation is None:
        return
    for option, value in (("--samples", samples), ("--settle", settle), ("--jig", jig)):
        if value is not None:
            raise UsageError(f"a rotation has no positions: leave {option} out; --turns limits its length")


def _outputs(
    procedure: Procedure, sensors: BenchFile, bench: str | Path | BenchFile | None, output: Path | None
) -> tuple[list[Path | None], Path]:
    """Return the calibration files, and the file beside which the journal lies.

    A bench's sensors each have a file of their own, named for their serial number, in the folder that -o names; those
    of a stage that turns have one together, which -o names.
    """
    if procedure.rotation is not None:
        if output is None or os.path.isdir(output):
            raise UsageError("the pairs of a stage have one file together: name it with -o PAIR.yaml")
        return [output, *(None for _ in sensors.sensors[1:])], output
    if bench is None and output is not None:
        check_writable(output)
        return [output], output
    folder = output or Path()
    if not os.path.isdir(folder):
        raise UsageError(f"with --bench, -o names the folder for the calibration files; {folder} is no folder")
    name = "bench" if isinstance(bench, BenchFile) else Path(str(bench)).name
    return [folder / f"{sensor.serial}.yaml" for sensor in sensors.sensors], folder / name
