"""Journals of earlier versions give the calibrations of their day; the virtual bench still writes their events."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from support import FIXTURES, ROOT

from tiltcal.bench.journal import calibrations_of
from tiltcal.errors import TiltcalError
from tiltcal.files.journal import read_journal
from tiltcal.library.measure import measure

DATA = ROOT / "tests" / "data"
ARCHIVE = DATA / "journals.tar.xz"

REFUSED = {
    "free-2026-11-21-f996473": "another version of tiltcal or of the procedure recorded it",  # the driver of an SCA3000
    "mounting-2026-11-21-5ea67d6": "unknown key 'thermometer_degrees'",  # a base calibration of an older format
    "mounting-2026-11-21-bb6cda8": "unknown key 'thermometer_degrees'",
}


def coefficients(text: str) -> dict[str, tuple[float, float]]:
    """Each coefficient of a file with its standard uncertainty."""

    def leaves(data: Any, path: str = "") -> Iterator[tuple[str, str]]:
        if isinstance(data, dict | list):
            for key, value in data.items() if isinstance(data, dict) else enumerate(data):
                yield from leaves(value, f"{path}.{key}")
        else:
            yield path, data

    file = yaml.load(text, yaml.BaseLoader)
    if file["kind"] == "pair":
        return {
            f"{number}.{key}": (float(pair[key]), float(pair["uncertainty"][key]))
            for number, pair in enumerate(file["pairs"])
            for key in "pq"
        }
    stated = dict(leaves(file["uncertainty"]))
    return {key: (float(one), float(stated[key])) for key, one in leaves(file["calibration"]) if key in stated}


def require_calibration_of_its_day(journal: Path, golden: Path) -> None:
    """Within three standard uncertainties of both together."""
    (text,) = calibrations_of(read_journal(journal)).texts().values()
    then, now = coefficients(golden.read_text(encoding="utf-8")), coefficients(text)
    for key in then.keys() & now.keys():
        (old, u_old), (new, u_new) = then[key], now[key]
        assert abs(new - old) <= 3.0 * (u_old**2 + u_new**2) ** 0.5, (journal, key)


def test_all_but_three_of_the_journals_of_before_give_the_calibration_of_their_day(tmp_path: Path) -> None:
    """They are 47 journals of three days."""
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    for folder in sorted(tmp_path.iterdir()):
        (path,) = folder.glob("*.journal.jsonl")
        (golden,) = folder.glob("*.yaml")
        if folder.name not in REFUSED:
            require_calibration_of_its_day(path, golden)
            continue
        with pytest.raises(TiltcalError, match=REFUSED[folder.name]):
            calibrations_of(read_journal(path))


def test_a_journal_in_which_the_last_position_was_measured_again_is_read() -> None:
    """Recorded when a channel that never changed had the last position measured again."""
    require_calibration_of_its_day(DATA / "measured-again.journal.jsonl", DATA / "measured-again.yaml")


@pytest.mark.parametrize("procedure", ["plane", "two-temperature"])
def test_the_virtual_bench_writes_the_events_of_a_fixture(
    procedure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(FIXTURES)
    sensor = {"sensor": "sca100t-d02", "serial": "SIM-42", "address": "sim:?twin=twins/sca100t-d02.yaml"}
    journal = tmp_path / "again.jsonl"
    output = tmp_path / "again.yaml"
    measure(procedure, operator="sim", journal=journal, output=output, samples=10, settle=0.006, **sensor)  # type: ignore[arg-type]
    again, fixture = (read_journal(path) for path in (journal, FIXTURES / f"{procedure}.journal.jsonl"))
    assert len(again.events) == len(fixture.events)
    for ours, theirs in zip(again.events, fixture.events, strict=True):
        assert (ours.dt_ns, ours.kind) == (theirs.dt_ns, theirs.kind)
        if ours.kind != "p":
            assert ours.payload == theirs.payload
        else:
            assert ours.payload[0]["sensors"] == theirs.payload[0]["sensors"]
