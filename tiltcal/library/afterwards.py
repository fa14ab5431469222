"""What the page in a browser offers after a session: the results, the live tilt, a verification and the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tiltcal.bench.journal import positions_of
from tiltcal.bench.live import live_tilts
from tiltcal.bench.measure import run_session
from tiltcal.bench.operators import LOOK, Message, Operator
from tiltcal.bench.session import Session
from tiltcal.bench.setup import SessionFiles, Setup, free_journal
from tiltcal.calibration.record import tilt_lines, tilt_uncertainty
from tiltcal.calibration.verification import Verification, verify_positions
from tiltcal.core.model import AXES
from tiltcal.errors import HardwareError, Stopped, TiltcalError
from tiltcal.files.bench import BenchFile, BenchSensor, BenchThermometer
from tiltcal.files.journal import read_journal
from tiltcal.files.procedure import find_procedure
from tiltcal.library.calibration import Calibration, PairCalibration

LIMIT = 0.5
"""The largest tilt error that passes, degrees, as that of ``tiltcal verify``."""


class Afterwards:
    """The page after a session, until somebody finishes it; ``remark`` takes what was written."""

    def __init__(
        self,
        operator: Operator,
        session: Session,
        calibrations: Mapping[str, Calibration | PairCalibration],
        remark: Callable[[str], None],
    ) -> None:
        self._operator, self._session, self._remark = operator, session, remark
        self._saved = calibrations
        self._of_tilt = {serial: one for serial, one in calibrations.items() if isinstance(one, Calibration)}
        self._results: dict[str, dict[str, Any]] = {
            serial: {
                "serial": serial,
                "file": str(session.files.outputs[serial]),
                "uncertainty": _uncertainty(one),
                "summary": str(one),
                "verdict": "",
                "report": "",
            }
            for serial, one in self._saved.items()
        }

    def show(self) -> None:
        """Show the results and what follows until somebody finishes."""
        actions = {"verify": self._verify, "report": self._report}
        while True:
            self._operator.tell({"event": "results", "results": list(self._results.values())})
            answer = self._answer()
            if answer == "finish":
                return
            try:
                actions[answer]()
            except Stopped as stop:
                self._refuse(f"{answer} is not finished: {stop}")
            except TiltcalError as error:
                self._refuse(str(error))

    def _answer(self) -> str:
        """Return what somebody chooses; until then show the live tilt, or why there is none."""
        question = {"ask": "afterwards", "verify": bool(self._of_tilt), "prompt": "Calibrated. The tilt here is live."}
        setup = self._session.setup
        devices = [device for device in setup.sensors if device.serial in self._of_tilt]
        records = {serial: one.record for serial, one in self._of_tilt.items()}
        while True:
            try:
                with live_tilts(devices, records, setup.thermometer) as read:
                    while (answer := self._asked(question)) == LOOK:
                        self._tell_live({serial: tilt.in_words() for serial, tilt in read().items()})
                    return answer
            except HardwareError as error:
                self._tell_live({serial: [("no reading", str(error), "")] for serial in records})
            if (answer := self._asked(question)) != LOOK:
                return answer

    def _asked(self, question: Message) -> str:
        answer: Any = self._operator.ask(question)
        return str(answer["answer"])

    def _tell_live(self, tilts: Mapping[str, list[tuple[str, str, str]]]) -> None:
        self._operator.tell({"event": "live", "tilts": tilts})

    def _refuse(self, why: str) -> None:
        self._operator.tell({"event": "refused", "position": "afterwards", "why": why})

    def _verify(self) -> None:
        """Measure the positions of ``verify`` with all sensors, and judge each."""
        setup, first = self._session.setup, next(iter(self._of_tilt))
        sensors = tuple(
            BenchSensor(one.serial, one.model, one.address, one.axes or AXES)
            for one in setup.sensors
            if one.serial in self._of_tilt
        )
        thermometer = setup.thermometer
        named = None if thermometer is None else BenchThermometer(thermometer.model, thermometer.address)
        bench = BenchFile(sensors, thermometer=named, jig=setup.settings.jig)
        file = self._session.files.outputs[first]
        journal = free_journal(file.with_name(f"{file.stem}.verify.yaml"), self._remark)
        steps = find_procedure("verify")
        verifying = Setup.begin(steps, bench, [None] * len(sensors), journal, operator="web")
        session = Session(verifying, SessionFiles(verifying, journal))
        session.probe()
        run_session(session, self._operator)
        results = positions_of(read_journal(journal)).results()
        for serial, one in self._of_tilt.items():
            measurements = [result.measurements[serial] for result in results]
            tilts = verify_positions(one.record, measurements, setup.settings.jig)
            self._results[serial]["verdict"] = str(Verification(one.sensor, tilts, LIMIT, setup.settings.jig))

    def _report(self) -> None:
        """Write the report of each calibration beside its file, and serve it."""
        for serial, one in self._saved.items():
            path = Path(self._results[serial]["file"]).with_suffix(".html")
            one.report(path)
            self._operator.tell({"event": "report", "sensor": serial, "page": path.read_bytes()})
            self._results[serial]["report"] = path.name
            self._remark(f"wrote {path}")


def _uncertainty(calibration: Calibration | PairCalibration) -> list[str]:
    """Return within how many degrees a tilt lies, a line an axis."""
    if isinstance(calibration, PairCalibration):
        return []
    by_axis = {axis: (one.tilt, one.alone) for axis, one in tilt_uncertainty(calibration.record).items()}
    return [" ".join(line.split()) for line in tilt_lines(by_axis)]
