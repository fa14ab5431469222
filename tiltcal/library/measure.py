"""Measuring from Python: what ``tiltcal measure`` does, as a function, and a sensor that can be read by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tiltcal.bench.device_setup import DeviceSetup
from tiltcal.bench.operators.selection import open_operator
from tiltcal.bench.sensor_set import open_device
from tiltcal.bench.session import Session, SessionResult
from tiltcal.bench.session_calibration import changes_in_words
from tiltcal.bench.session_start import StatedSession, start_session
from tiltcal.bench.virtual_bench import VirtualBench
from tiltcal.calibration.level import NO_LEVEL, level_summary
from tiltcal.calibration.summary import NOT_FOLLOWED, summary, verdict
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import session_clock
from tiltcal.drivers.model import Sensor, link_in_words
from tiltcal.files.bench import BenchFile
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.library.calibration import Calibration
from tiltcal.library.pair_calibration import PairCalibration
from tiltcal.stated_arguments import of_python, require_boolean, require_path


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
    result: Callable[[str], None] | None = None,
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
    result : callable, optional
        Gets the coefficients of each calibration with their uncertainties, lines of text; not with the operator
        ``json``, whose program reads the files.

    Returns
    -------
    Calibration, PairCalibration or list of Calibration
        Of the sensor, of the pairs of a stage, or of each of several sensors; a type checker cannot infer which.

    Raises
    ------
    UsageError, InputError
        What is asked for cannot be done; nothing was measured.
    HardwareError
        A device failed for good, or sensors of a bench were given up.
    Stopped
        The operator stopped; the message says how to go on.
    """
    for option, value in (("--typical-temperature", typical_temperature), ("--closing", closing), ("--plain", plain)):
        require_boolean(option, value)
    for option, file in (("--base", base), ("--journal", journal), ("--resume", resume), ("-o", output)):
        if file is not None:
            require_path(option, file)
    stated = StatedSession(
        procedure=procedure,
        operator=operator,
        sensor=sensor,
        address=address,
        serial=serial,
        output=None if output is None else Path(output),
        bench=bench,
        samples=of_python(samples),
        settle=of_python(settle),
        jig=of_python(jig),
        table_lean=of_python(table_lean),
        heading=of_python(heading),
        tilt=of_python(tilt),
        turns=of_python(turns),
        alignment=of_python(alignment),
        base=base,
        typical_temperature=of_python(typical_temperature),
        closing=of_python(closing),
        journal=None if journal is None else Path(journal),
        resume=None if resume is None else Path(resume),
    )
    session = start_session(stated, remark)
    session.require_writable()
    operator = operator or session.plan.operator
    turns_stage, virtual = session.plan.procedure.rotation is not None, session.plan.virtual
    with session.resumable("measure", remark):
        session.probe()
        with open_operator(operator, turns=turns_stage, virtual=virtual, say=remark, plain=bool(plain)) as opened:
            outcome = session.run(opened)
            outcome.write()
            opened.done(list(outcome.calibrations), session.path)
            outcome.require_all()
    return _results(session, outcome, remark, None if operator == "json" else result)


def _remark_notes(
    calibrations: Sequence[Calibration], remark: Callable[[str], None], *, renewed: bool, judged: bool
) -> None:
    """Remark each verdict and note once, with its sensors; after ``level``, not again those of the base.

    A verdict that was ``judged`` before is not repeated.
    """
    having: dict[str, list[str]] = {}
    for calibration in calibrations:
        said = () if judged else verdict(calibration.record)
        for note in (*said, *calibration.fit.notes):
            if not renewed or note == NO_LEVEL or NOT_FOLLOWED in note:
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


def _results(
    session: Session, outcome: SessionResult, remark: Callable[[str], None], result: Callable[[str], None] | None
) -> Calibration | PairCalibration | list[Calibration]:
    """Return what a session found, and remark what limits it."""
    for name, statistics in outcome.ending.link_statistics_by_serial.items():
        remark(f"{name}: {link_in_words(statistics)}")
    records, determines = list(outcome.calibrations.values()), session.plan.procedure.determines
    if session.plan.procedure.rotation is not None:
        pair = PairCalibration(records[0])  # type: ignore[arg-type]
        (result or unheard)(str(pair))
        return pair
    calibrations = [Calibration(record) for record in records if isinstance(record, CalibrationRecord)]
    _remark_notes(calibrations, remark, renewed=determines.level, judged=result is not None)
    for calibration in calibrations:
        if determines.level:
            (result or remark)(level_summary(calibration.record))
        else:
            (result or unheard)(summary(calibration.record, notes=False))
        if session.plan.procedure.closes:
            remark(changes_in_words(calibration.record))
    return calibrations[0] if len(session.plan.sensors) == 1 else calibrations
