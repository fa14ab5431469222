"""Planning and measuring from Python: what ``tiltcal plan`` and ``tiltcal measure`` do, as functions."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from math import hypot
from pathlib import Path
from shlex import quote
from typing import Any, Unpack, cast

from tiltcal.bench.measure import led_by, run_session
from tiltcal.bench.messages import Done
from tiltcal.bench.options import MeasureOptions, PlanOptions, unheard
from tiltcal.bench.reference import reference_of
from tiltcal.bench.session import Session
from tiltcal.bench.setup import free_journal, known_bench, new_setup, require_trusted, single
from tiltcal.calibration.complete import NO_LEVEL
from tiltcal.calibration.measurement import BenchUncertainty, require_suitable, unchecked
from tiltcal.calibration.prediction import Plan, predict
from tiltcal.calibration.record import bases_of
from tiltcal.calibration.wording import NOT_FOLLOWED, level_summary, summary, verdict
from tiltcal.core.rounding import plus_minus
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.model import link_in_words
from tiltcal.errors import Argument, HardwareError, JournalError, UsageError, listed
from tiltcal.files.atomic import require_apart
from tiltcal.files.bench import BenchFile
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.defaults import Defaults
from tiltcal.files.device import model_named
from tiltcal.files.document import read_document
from tiltcal.files.pair import PairRecord
from tiltcal.files.procedure import Procedure, Rotation, find_procedure
from tiltcal.journal.calibrations import texts_of
from tiltcal.journal.header import Setup, stage_channels
from tiltcal.journal.lines import Journal
from tiltcal.journal.reference import uncertainty_with
from tiltcal.journal.session import RecordedSession
from tiltcal.library.calibration import Calibration, PairCalibration
from tiltcal.options import complete, flag_of, options_of, takes
from tiltcal.stated_arguments import of_python, require_name

_NOT_PREDICTED = (
    "nothing can be predicted before the stage turns: p and q will have a standard uncertainty of 2 s / (A sqrt(n)), "
    "after n samples of noise s, where A is the amplitude of an accelerometer at the spin frequency"
)

NOT_REPEATED = (  # the options that a session which goes on may have anew
    "output", "resume", "operator", "plain", "python", "hands_free", "listen", "defaults", "remark", "result",
)  # fmt: skip


@takes(PlanOptions)
def plan(procedure: str | Path, **options: Unpack[PlanOptions]) -> Plan:
    """Predict how well a procedure will determine every coefficient, before anybody starts.

    Parameters
    ----------
    procedure : str or Path
        Its name, or the path of your own.
    **options

    Returns
    -------
    Plan
        It prints as ``tiltcal plan`` does; ``uncertainty`` is by the name of each coefficient. That of the pairs of a
        stage depends on their amplitude, which is not known before it turns.

    Raises
    ------
    EstimateError
        The positions cannot determine what the procedure asks for; the message names the position to add.
    UsageError
        The model or the procedure is unknown, or does not go with the other.

    Examples
    --------
    >>> print(tiltcal.plan("zero-45", sensor="sca100t-d02", jig=0.1))
    """
    stated = complete(PlanOptions, options)
    jig, noise, samples, base = stated["jig"], stated["noise"], stated["samples"], stated["base"]
    own = None if base is None else read_calibration(base)
    name = stated["sensor"] or (None if own is None else own.sensor.model)
    if name is None:
        raise UsageError(("name the ", Argument("sensor"), " model, or its calibration with ", Argument("base")))
    model = model_named(name)
    if (address := stated["address"]) is not None:
        model = model.at(parse_address(address))
    steps = find_procedure(procedure, stated["tilt"]).with_alignment(stated["alignment"])
    if stated["closing"]:
        steps = steps.in_positions().with_closing()
    steps.require_usable(jig=jig)
    if own is not None or steps.renews:
        bases_of(steps, base, [] if own is None else [own.sensor.serial])
    if isinstance(steps, Rotation):
        channels = stage_channels(steps, [("", model)])
        pairs = [{"pair": [pair.first, pair.second], "orthogonal": pair.orthogonal} for pair in channels.pairs]
        lines = [f"{pair.first} and {pair.second}, orthogonal {pair.orthogonal}" for pair in channels.pairs]
        data = {"pairs": pairs, "turns": steps.turns, "left_out": list(channels.left_out)}
        return Plan({**data, "why": _NOT_PREDICTED}, "\n".join([*lines, *channels.left_out, _NOT_PREDICTED]))
    steps = steps.in_positions()
    require_suitable(steps, model)
    stated_bench = stated["bench"]
    known = None if stated_bench is None else known_bench(read_document(stated_bench))
    if known is not None:
        known = known.with_stated(jig=jig, table_lean=stated["table_lean"])
        jig, stated["table_lean"] = known.jig, known.table_lean
    jig = (stated["defaults"] or Defaults)().instead("jig", jig)
    bench = BenchUncertainty(jig, stated["thermometer"], stated["table_lean"])
    bench = uncertainty_with(None if known is None else reference_of(known), bench)
    return predict(steps, model, bench, noise=noise, samples=samples, base=own)


@takes(MeasureOptions)
def measure(procedure: str | Path | None = None, **options: Unpack[MeasureOptions]) -> Calibration | Any:
    """Take sensors through a procedure, and write their calibration files.

    Everything is captured in a journal as it happens. After an interruption the same call with ``resume`` goes on from
    the last byte.

    Parameters
    ----------
    procedure : str or Path
        A shipped procedure by its name, or your own by its path.
    **options

    Notes
    -----
    An ``operator`` may also be an object with the methods of :mod:`tiltcal.bench.operators`: ``position(ask)`` returns
    an answer such as ``{"answer": "ready", "tilt": {"y": 30.02}}``; for a turning stage ``rotation(ask)``.

    Returns
    -------
    Calibration, PairCalibration or list of Calibration
        Of the sensor, of the pairs of a stage, or of each of several sensors; a type checker cannot infer which. None
        after a dry run.

    Raises
    ------
    UsageError, InputError
        What is asked for cannot be done; nothing was measured.
    HardwareError
        A device failed for good, or sensors of a bench were given up.
    Stopped
        The operator stopped; the message says how to go on.
    """
    stated = complete(MeasureOptions, options)
    given = cast(MeasureOptions, {name: of_python(value) for name, value in stated.items()})
    remark, result, resume = given["remark"], given["result"], given["resume"]
    if given["dry_run"]:
        from tiltcal.bench.dry_run import dry_run

        dry_run(_begun(procedure, given).setup, result or remark)
        return None
    if resume is not None and os.path.exists(resume):
        output = None if given["output"] is None else Path(given["output"])
        session = resumed(Path(resume), output, _stated_again(procedure, given), remark, given["python"])
    else:
        session = _begun(procedure, given)
    operator = given["operator"] or session.setup.operator
    with led_by(operator, session, "measure", remark, given) as opened:
        made = run_session(session, opened)
        files = [str(path) for path in session.files.write(texts_of(made), remark)]
        opened.tell(Done(files, str(session.files.journal)))
        if lost := session.recorded.lost:
            raise HardwareError("no calibration file for " + "; ".join(lost.values()))
        results = _results(session, list(made.values()), remark, None if operator == "json" else result)
        if operator == "web":
            from tiltcal.library.afterwards import Afterwards

            every = results if isinstance(results, list) else [results]
            with suppress(KeyboardInterrupt):  # everything is written
                Afterwards(opened, session, dict(zip(made, every, strict=False)), remark).show()
    return results


def _stated_again(procedure: str | Path | None, given: MeasureOptions) -> dict[str, object]:
    """Return what is stated beside ``resume`` and changes nothing, by option."""
    flags = {name: flag_of(name, option) for name, (option, _) in options_of(MeasureOptions).items()}
    again = {flags[name]: value for name, value in given.items() if name not in NOT_REPEATED}
    return {"PROCEDURE": procedure, **again}


def resumed(
    path: Path,
    output: Path | None,
    stated: Mapping[str, object],
    remark: Callable[[str], None],
    trusted: str | None,
    *,
    verifies: bool = False,
) -> Session:
    """Return the session of a journal; options that are stated again are a remark, for it goes on as it began.

    ``stated`` are values by option, None and False of those that are not stated. ``output`` takes the place of where
    the journal says that calibrations go; ``trusted`` are modules of Python that it may import.

    JournalError: it cannot be read or used.
    UsageError: it is not of a verification, or is of one, as ``verifies`` asks.
    """
    journal = Journal(path)
    setup = Setup.of(journal)
    if setup.verifies != verifies:
        kind = "verification" if setup.verifies else "measurement"
        raise UsageError(f"{path} is of a {kind}; continue it with: {setup.resume_command(path)}")
    require_trusted(journal.header, path, trusted)
    recorded = RecordedSession(journal, setup)
    if journal.torn:
        remark(f"{path}: the last line was torn off and is dropped")
    repeated = [option for option, value in stated.items() if value is not None and value is not False]
    if repeated:
        remark(f"the session goes on as it began: {', '.join(repeated)} beside --resume changes nothing")
    return Session(setup, path, recorded, output)


def _begun(procedure: str | Path | None, given: MeasureOptions) -> Session:
    """Return a new session, and remark how well it will determine the coefficients."""
    base, remark, named = given["base"], given["remark"], cast("BenchFile | str | Path | None", given["bench"])
    defaults = (given["defaults"] or Defaults)()
    one = _one_sensor(procedure, given, "folder" in defaults.values)
    steps = find_procedure(str(procedure), given["tilt"])
    steps = steps.with_turns(given["turns"]).with_alignment(given["alignment"])
    if given["closing"]:
        steps = steps.in_positions().with_closing()
    steps.require_usable(samples=given["samples"], settle=given["settle"], jig=given["jig"])
    if named is None:
        require_name(one["serial"], "the serial number")
        bench = single(str(one["sensor"]), str(one["serial"]), str(one["address"]))
    elif isinstance(named, BenchFile):
        bench = named
    else:
        bench = known_bench(read_document(named))
        require_trusted(bench, named, given["python"])
    bench = bench.with_stated(jig=given["jig"], table_lean=given["table_lean"], heading=given["heading"])
    bench = defaults.completing(bench, "operator", "references", *([] if steps.one_file else ["jig"]))
    output = given["output"] if steps.one_file else defaults.instead("folder", given["output"])
    if output is not None:
        output = Path(output) / ("" if given["output"] or named else f"{one['serial']}.yaml")
    bases = bases_of(steps, base, [sensor.serial for sensor in bench.sensors])
    outputs, beside = _outputs(steps, bench, named, output)
    read = [path for path in (procedure, base, named) if isinstance(path, str | Path) and os.path.isfile(path)]
    for written in filter(None, outputs):
        require_apart(written, *read)
    path = given["resume"] or given["journal"]
    path = free_journal(beside, remark) if path is None else Path(path)
    operator = given["operator"] or "terminal"
    setup = new_setup(
        steps,
        bench,
        outputs,
        path,
        operator=operator if isinstance(operator, str) else "json",
        samples=given["samples"],
        settle=given["settle"],
        angles=given["angles"],
        bases=bases,
        typical=given["typical_temperature"],
    )
    _predict(setup, remark)
    for why in setup.overdue():
        remark(why)
    try:
        if named is not None or given["output"] is None:
            beside.parent.mkdir(exist_ok=True)
    except OSError as error:
        why = f"{beside.parent}, the folder for the calibration files, cannot be made: {error.strerror}"
        raise UsageError(why, advice=("name another with ", Argument("output"))) from None
    return Session(setup, path)


def _one_sensor(procedure: str | Path | None, given: MeasureOptions, filed: bool) -> dict[str, str | None]:
    """Return model, address and serial number of one sensor, stated or of its base; refuse what is not stated.

    ``filed`` is whether the output has a default.
    """
    if given["dry_run"] and given["bench"] is None:
        moves = "moves the machines of a bench file"
        raise UsageError(option="dry_run", why=moves, advice=("state ", Argument("bench")))
    sensor, serial, base = given["sensor"], given["serial"], given["base"]
    if base is not None and given["bench"] is None and os.path.isfile(base):
        identity = read_calibration(base).sensor
        sensor, serial = sensor or identity.model, serial or identity.serial
    one = {"sensor": sensor, "address": given["address"], "serial": serial}
    wanted = {"procedure": procedure, **({} if given["bench"] is not None else {**one, "output": given["output"]})}
    absent = [name for name, value in wanted.items() if value is None and not (filed and name == "output")]
    if given["resume"] is not None and absent:
        raise JournalError("no such journal", file=str(given["resume"]))
    if absent:
        raise UsageError(("measure needs ", *listed(absent), " (or ", Argument("resume", "JOURNAL"), ")"))
    if given["bench"] is not None and any(one.values()):
        why = ("the ", Argument("bench"), " file names the sensors")
        raise UsageError(why, advice=("leave ", *listed(one), " out"))
    return one


def _predict(setup: Setup, remark: Callable[[str], None]) -> None:
    """Remark how well the positions will determine the coefficients; refuse those that cannot."""
    if setup.steps.needs_base:
        return
    if isinstance(setup.steps, Rotation):
        for why in setup.stage_channels().left_out:
            remark(why)
        if len(setup.sensors) > 1:
            remark("several devices are read one after the other: the delay of one, times 2 pi f, goes into q")
        return
    for device in setup.sensors:
        if why := unchecked(device.wired):
            remark(f"{device.serial}: {why}")
    for device in {(sensor.model, sensor.orientation): sensor for sensor in setup.sensors}.values():
        base = setup.bases.get(device.serial)
        settings = setup.settings
        bench = uncertainty_with(
            setup.reference, BenchUncertainty(settings.jig, settings.thermometer, settings.table_lean)
        )
        expected = predict(
            setup.steps.in_positions(),
            device.wired,
            bench,
            samples=setup.settings.samples,
            settle=setup.settings.settle,
            orientation=device.orientation,
            sensors=len(setup.sensors),
            base=None if base is None else base.calibration,
            proposing=False,
        )
        more = "" if expected.data.get("degrees_of_freedom", 1) else "; no residuals are left to check the result"
        remark(f"{device.model}: {expected.brief}{more}; tiltcal plan says the rest")


def _outputs(
    procedure: Procedure, sensors: BenchFile, bench: str | Path | BenchFile | None, output: Path | None
) -> tuple[list[Path | None], Path]:
    """Return the calibration files, and the file beside which the journal lies.

    A bench's sensors each have a file of their own, named for their serial number, in the folder that -o names; those
    of a stage that turns have one together, which -o names.
    """
    if procedure.one_file:
        if output is None or os.path.isdir(output):
            advice = ("name it with ", Argument("output", "PAIR.yaml"))
            raise UsageError("the pairs of a stage have one file together", advice=advice)
        return [output, *(None for _ in sensors.sensors[1:])], output
    if bench is None and output is not None:
        return [output], output
    folder = output or Path()
    name = "bench" if isinstance(bench, BenchFile) else Path(str(bench)).name
    return [folder / f"{sensor.serial}.yaml" for sensor in sensors.sensors], folder / name


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


def _results(
    session: Session,
    records: Sequence[CalibrationRecord | PairRecord],
    remark: Callable[[str], None],
    result: Callable[[str], None] | None,
) -> Calibration | PairCalibration | list[Calibration]:
    """Return what a session gives, and remark what limits it."""
    for name, statistics in session.recorded.playback.link_statistics().items():
        remark(f"{name}: {link_in_words(statistics)}")
    setup, steps = session.setup, session.setup.steps
    if isinstance(records[0], PairRecord):
        pair = PairCalibration(records[0])
        (result or unheard)(str(pair))
        return pair
    calibrations = [Calibration(record) for record in records if isinstance(record, CalibrationRecord)]
    _remark_notes(calibrations, remark, renewed=steps.renews, judged=result is not None)
    for calibration in calibrations:
        if steps.renews:
            (result or remark)(level_summary(calibration.record))
        else:
            (result or unheard)(summary(calibration.record, notes=False))
        if steps.in_positions().closes:
            remark(changes_in_words(calibration.record))
    if result is not None:
        file = quote(str(session.files.outputs[calibrations[0].sensor.serial]))
        where = "--bench BENCH.yaml" if setup.reference else f"--address {quote(setup.sensors[0].address)}"
        remark(f"next: tiltcal verify {file} {where}, then tiltcal apply {file} LOG.csv -o TILT.csv")
        remark(f"      or tiltcal export {file} --to c -o tilt.h")
    return calibrations[0] if len(setup.sensors) == 1 else calibrations


def changes_in_words(calibration: CalibrationRecord) -> str:
    """Return how the readings of the last position differ from those of the first, where both are one position."""
    first, last = calibration.positions[0], calibration.positions[-1]
    coefficients, unit = calibration.coefficients, calibration.sensor.fitted_unit
    parts = []
    for channel in coefficients.channels:
        change = last.mean[channel] - first.mean[channel]
        u = hypot((first.u or {}).get(channel, 0.0), (last.u or {}).get(channel, 0.0))
        milligravity = 1000 * change / abs(coefficients.own_sensitivity(channel))
        parts.append(f"{channel} {plus_minus(change, 2 * u, signed=True)} {unit} ({milligravity:+.2g} mg)")
    return f"{calibration.sensor.serial}: back in {first.position} the readings have changed by {', '.join(parts)}"
