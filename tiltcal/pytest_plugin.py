"""A plugin of pytest that makes a test of each journal: ``pytest --tiltcal-journals DIR``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

_GOLDEN = "the folder of their golden calibration files [that of each journal]"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options; the name is pytest's."""
    group = parser.getgroup("tiltcal")
    group.addoption("--tiltcal-journals", metavar="DIR", type=Path, help="replay the journals in a folder and below")
    group.addoption("--tiltcal-golden", metavar="DIR", type=Path, help=_GOLDEN)


def pytest_collection_modifyitems(session: pytest.Session, config: pytest.Config, items: list[pytest.Item]) -> None:
    """Add a test of each journal; the name is pytest's."""
    if (folder := config.getoption("tiltcal_journals")) is None:
        return
    from tiltcal.errors import UsageError
    from tiltcal.library.replay import journals_in

    try:
        journals = journals_in([folder])
    except UsageError as none:
        raise pytest.UsageError(str(none)) from None
    golden = config.getoption("tiltcal_golden")
    for journal in journals:
        name = journal.relative_to(folder).as_posix()
        items.append(JournalTest.from_parent(session, name=name, nodeid=str(journal), journal=journal, golden=golden))


class JournalTest(pytest.Item):
    """The replay of a journal, which must give its golden files to the byte."""

    def __init__(self, *, journal: Path, golden: Path | None, **named: Any) -> None:
        super().__init__(**named)
        self._journal, self._golden = journal, golden or journal.parent

    def runtest(self) -> None:
        """Fail with all lines that differ."""
        from tiltcal.errors import TiltcalError
        from tiltcal.library.replay import replay

        try:
            differences = replay(self._journal).differences(self._golden)
        except TiltcalError as error:
            pytest.fail(str(error), pytrace=False)
        if differences:
            pytest.fail("\n".join(differences), pytrace=False)

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return where the test stands; the name is pytest's."""
        return self._journal, None, self.name
