"""The start of a session: a new plan of what the caller states, or the plan that a journal holds."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote

from tiltcal.bench.device_setup import known_bench, single
from tiltcal.bench.session import Session
from tiltcal.bench.session_plan import SessionPlan, plan_session
from tiltcal.calibration.free_positions import require_no_jig
from tiltcal.calibration.prediction import predict
from tiltcal.calibration.suitability import unchecked
from tiltcal.errors import JournalError, UsageError
from tiltcal.files.atomic import check_writable
from tiltcal.files.base_calibration import bases_of
from tiltcal.files.bench import BenchFile
from tiltcal.files.calibration import read_calibration
from tiltcal.files.document import read_document
from tiltcal.files.procedure import Procedure
from tiltcal.files.procedure_file import find_procedure
from tiltcal.stated_arguments import require_above_zero, require_from_zero, require_name, require_whole


@dataclass(frozen=True, kw_only=True)
class StatedSession:
    """The parameters of :func:`tiltcal.measure`; None and False stand for what is not stated."""

    procedure: str | Path | None
    operator: object
    sensor: str | None
    address: str | None
    serial: str | None
    output: Path | None
    bench: str | Path | BenchFile | None
    samples: int | None
    settle: float | None
    jig: float | None
    table_lean: float | None
    heading: float | None
    tilt: float | None
    turns: int | None
    alignment: float | None
    base: str | Path | None
    typical_temperature: bool
    closing: bool
    journal: Path | None
    resume: Path | None


def start_session(stated: StatedSession, remark: Callable[[str], None]) -> Session:
    """Return the session of the journal to resume, or a new one.

    UsageError, InputError: what is stated cannot be done, or is not what the journal began with.
    """
    require_from_zero("--heading-uncertainty", stated.heading)
    if stated.resume is not None and os.path.exists(stated.resume):
        return _resumed(stated.resume, stated, remark)
    return _begun(stated, remark)


def _resumed(journal: Path, stated: StatedSession, remark: Callable[[str], None]) -> Session:
    """Return the session of a journal, whose one calibration goes to the output where that is named."""
    session = Session.of_journal(journal, remark, stated.output)
    if not session.outputs:
        raise UsageError(
            f"{journal} is of a verification; continue it with: tiltcal verify CAL --resume {quote(str(journal))}"
        )
    begun = session.plan
    serials = [device.serial for device in begun.sensors]
    begun.require_as_begun(
        {
            "PROCEDURE": stated.procedure,
            "--sensor": stated.sensor,
            "--address": stated.address,
            "--serial": stated.serial,
            "--bench": None if stated.bench is None else _bench(stated.bench),
            "--base": None if stated.base is None else bases_of(begun.procedure, stated.base, serials),
            "--journal": None if stated.journal is None else stated.journal.name,
            "--samples": stated.samples,
            "--settle": stated.settle,
            "--jig": stated.jig,
            "--table-lean": stated.table_lean,
            "--heading-uncertainty": stated.heading,
            "--tilt": stated.tilt,
            "--turns": stated.turns,
            "--alignment": stated.alignment,
            "--typical-temperature": stated.typical_temperature,
            "--closing": stated.closing,
        }
    )
    return session


def _begun(stated: StatedSession, remark: Callable[[str], None]) -> Session:
    """Return a new session, and remark how well it will determine the coefficients."""
    if stated.base is not None and stated.bench is None and os.path.isfile(stated.base):
        identity = read_calibration(stated.base).sensor
        stated = replace(stated, sensor=stated.sensor or identity.model, serial=stated.serial or identity.serial)
    _require_named(stated)
    steps = find_procedure(str(stated.procedure), stated.tilt)
    steps = steps.with_turns(stated.turns).with_alignment(stated.alignment).with_closing(stated.closing)
    if stated.bench is None:
        require_name(str(stated.serial), "the serial number")
    _require_settings(steps, stated)
    sensors = _sensors(stated)
    bases = bases_of(steps, stated.base, [sensor.serial for sensor in sensors.sensors])
    outputs, beside = _outputs(steps, sensors, stated)
    path = stated.resume or stated.journal or free_journal(beside, remark)
    operator = stated.operator or "terminal"
    plan = plan_session(
        steps,
        sensors,
        outputs,
        path,
        operator=operator if isinstance(operator, str) else "json",
        samples=stated.samples,
        settle=stated.settle,
        bases=bases,
        typical=stated.typical_temperature,
    )
    _predict(plan, remark)
    if steps.rotation is None:
        _make_folder(beside.parent)
    return Session(plan, path)


def _require_named(stated: StatedSession) -> None:
    """Refuse a session whose procedure or sensor is not named."""
    sensor = {"--sensor": stated.sensor, "--address": stated.address, "--serial": stated.serial}
    wanted = {"PROCEDURE": stated.procedure}
    if stated.bench is None:
        wanted |= {**sensor, "-o": stated.output}
    missing = [name for name, value in wanted.items() if value is None]
    if stated.resume is not None and missing:
        raise JournalError("no such journal", file=str(stated.resume))
    if missing:
        raise UsageError(f"measure needs {', '.join(missing)} (or --resume JOURNAL); see tiltcal measure --help")
    if stated.bench is not None and any(sensor.values()):
        raise UsageError("the --bench file names the sensors: leave --sensor, --address and --serial out")


def _sensors(stated: StatedSession) -> BenchFile:
    """Return the bench, or the one sensor, with the uncertainties that are stated in place of its own."""
    if stated.bench is not None:
        bench = _bench(stated.bench)
    else:
        bench = single(str(stated.sensor), str(stated.serial), str(stated.address))
    return bench.replaced(
        jig=bench.jig if stated.jig is None else stated.jig,
        table=bench.table if stated.table_lean is None else stated.table_lean,
        heading=bench.heading if stated.heading is None else stated.heading,
    )


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
    for device in plan.sensors:
        if why := unchecked(device.model):
            remark(f"{device.serial}: {why}")
    for device in {(sensor.model_name, sensor.orientation): sensor for sensor in plan.sensors}.values():
        base = plan.bases.get(device.serial)
        expected = predict(
            plan.procedure,
            device.model,
            jig=plan.settings.jig,
            thermometer=plan.settings.thermometer,
            table_lean=plan.settings.table,
            samples=plan.settings.samples,
            orientation=device.orientation,
            sensors=len(plan.sensors),
            base=None if base is None else base.calibration,
        )
        remark(f"{device.model_name}, {expected}")


def _require_settings(procedure: Procedure, stated: StatedSession) -> None:
    """Refuse settings that the procedure does not have, or with which no session can measure."""
    require_no_jig(procedure, stated.jig)
    require_whole("--samples", stated.samples, 2, "samples")
    require_above_zero("--settle", stated.settle)
    if procedure.rotation is None:
        return
    for option, value in (("--samples", stated.samples), ("--settle", stated.settle), ("--jig", stated.jig)):
        if value is not None:
            raise UsageError(f"a rotation has no positions: leave {option} out; --turns limits its length")


def _outputs(procedure: Procedure, sensors: BenchFile, stated: StatedSession) -> tuple[list[Path | None], Path]:
    """Return the calibration files, and the file beside which the journal lies.

    A bench's sensors each have a file of their own, named for their serial number, in the folder that -o names; those
    of a stage that turns have one together, which -o names.
    """
    bench, output = stated.bench, stated.output
    if procedure.rotation is not None:
        if output is None or os.path.isdir(output):
            raise UsageError("the pairs of a stage have one file together: name it with -o PAIR.yaml")
        return [output, *(None for _ in sensors.sensors[1:])], output
    if bench is None and output is not None:
        check_writable(output)
        return [output], output
    folder = output or Path()
    name = "bench" if isinstance(bench, BenchFile) else Path(str(bench)).name
    return [folder / f"{sensor.serial}.yaml" for sensor in sensors.sensors], folder / name


def _make_folder(folder: Path) -> None:
    """Make the folder of a bench's calibration files, unless it is there."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        why = f"{folder} cannot be made: {error.strerror}"
        raise UsageError(f"with --bench, -o names the folder for the calibration files; {why}") from None


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
