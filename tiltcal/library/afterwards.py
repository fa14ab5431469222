"""What the page in a browser offers after a session: the results, the live tilt, a verification and the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from tiltcal.bench.live import live_tilts
from tiltcal.bench.measure import run_session
from tiltcal.bench.messages import AfterwardsQuestion as Question
from tiltcal.bench.messages import Live, Refused, Report, Results
from tiltcal.bench.operators import LOOK, Operator
from tiltcal.bench.session import Session
from tiltcal.bench.setup import free_journal, new_setup
from tiltcal.calibration.measurement import BenchUncertainty
from tiltcal.calibration.tilt_uncertainty import stated_half_widths, tilt_lines
from tiltcal.calibration.verification import LIMIT, Verification, verify
from tiltcal.errors import HardwareError, TiltcalError
from tiltcal.files.bench import BenchFile, BenchSensor, BenchThermometer
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import find_procedure
from tiltcal.journal.reference import uncertainty_with
from tiltcal.library.calibration import Calibration, PairCalibration


def verified(
    session: Session, operator: Operator, calibrations: Mapping[str, CalibrationRecord], limit: float = LIMIT
) -> dict[str, Verification]:
    """Measure the positions of a session, and judge how calibrations by serial number read them."""
    session.judged = calibrations
    run_session(session, operator)
    results = session.recorded.results()
    bench = uncertainty_with(session.setup.reference, BenchUncertainty(session.setup.settings.jig))
    return {
        serial: verify(record, [result.measurements[serial] for result in results], limit, bench)
        for serial, record in calibrations.items()
    }


class Afterwards:
    """The page after a session, until somebody finishes it; ``remark`` takes what was written."""

    def __init__(
        self,
        operator: Operator,
        session: Session,
        calibrations: Mapping[str, Calibration | PairCalibration],
        remark: Callable[[str], None],
    ) -> None:
        self._operator, self._session, self._saved, self._remark = operator, session, calibrations, remark
        self._of_tilt = {serial: one.record for serial, one in calibrations.items() if isinstance(one, Calibration)}
        self._devices = [device for device in session.setup.sensors if device.serial in self._of_tilt]
        self._results: dict[str, dict[str, object]] = {
            serial: {"serial": serial, "file": str(session.files.outputs[serial]), "summary": str(one)}
            for serial, one in calibrations.items()
        }
        for serial, record in self._of_tilt.items():
            tilts = tilt_lines(stated_half_widths(record))
            self._results[serial]["uncertainty"] = [" ".join(line.split()) for line in tilts]

    def show(self) -> None:
        """Show the results and what follows until somebody finishes."""
        while True:
            self._operator.tell(Results(list(self._results.values())))
            answer = self._answer()
            try:
                match answer:
                    case "finish":
                        return
                    case "verify":
                        self._verify()
                    case "report":
                        self._report()
            except TiltcalError as error:
                self._operator.tell(Refused(answer, f"not finished: {error}"))

    def _answer(self) -> str:
        """Return what somebody chooses; until then show the live tilt, or why there is none."""
        question = Question(verify=bool(self._of_tilt), prompt="Calibrated. The tilt here is live.")
        while True:
            try:
                with live_tilts(self._devices, self._of_tilt, self._session.setup.thermometer) as read:
                    while (answer := self._asked(question)) == LOOK:
                        tilts = {serial: tilt.in_words() for serial, tilt in read().items()}
                        self._operator.tell(Live(tilts))
                    return answer
            except HardwareError as error:
                dead = {serial: [("no reading", str(error), "")] for serial in self._of_tilt}
                self._operator.tell(Live(dead))
            if (answer := self._asked(question)) != LOOK:
                return answer

    def _asked(self, question: Question) -> str:
        answer = self._operator.ask(question)
        return str(answer.get("answer")) if isinstance(answer, Mapping) else ""

    def _verify(self) -> None:
        """Measure the positions of ``verify`` with all sensors, and judge each."""
        setup, jig = self._session.setup, self._session.setup.settings.jig
        sensors = tuple(BenchSensor(one.serial, one.model, one.address, one.axes, one.device) for one in self._devices)
        thermometer = setup.thermometer
        named = (
            None
            if thermometer is None
            else BenchThermometer(thermometer.model, thermometer.address, device=thermometer.device)
        )
        file = self._session.files.outputs[sensors[0].serial]
        journal = free_journal(file.with_name(f"{file.stem}.verify.yaml"), self._remark)
        bench, outputs = BenchFile(sensors, thermometer=named, jig=jig), [None] * len(sensors)
        verifying = new_setup(
            find_procedure("verify").in_positions().verifying(), bench, outputs, journal, operator="web"
        )
        session = Session(verifying, journal)
        session.probe()
        for serial, verification in verified(session, self._operator, self._of_tilt).items():
            self._results[serial]["verdict"] = str(verification)

    def _report(self) -> None:
        """Write the report of each calibration beside its file, and serve it."""
        for serial, one in self._saved.items():
            path = Path(str(self._results[serial]["file"])).with_suffix(".html")
            one.report(path)
            self._operator.tell(Report(serial, path.read_bytes()))
            self._results[serial]["report"] = path.name
            self._remark(f"wrote {path}")
