"""The matching of accelerometer pairs as a program holds it: p and q, and what they suppress."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, overload

from tiltcal.calibration.pair_summary import pair_summary
from tiltcal.core.pair.compensation import PairCompensation
from tiltcal.core.pair.matching import Matching
from tiltcal.files.atomic import write_whole
from tiltcal.files.pair import PairRecord, dump_pair
from tiltcal.files.results import PairProvenance
from tiltcal.logs.options import ApplyOptions
from tiltcal.options import complete

Frame = TypeVar("Frame")
"""A frame of any kind: the same kind comes back; without their stubs those of pandas and pyarrow are Any."""


@dataclass(frozen=True, eq=False)
class PairCalibration:
    """The matching of one or two accelerometer pairs on a rotary stage.

    Attributes
    ----------
    record : PairRecord
        The content of its file.
    """

    record: PairRecord

    @property
    def matchings(self) -> tuple[Matching, ...]:
        """The pairs: ``p`` and ``q`` with their uncertainties, components before and after, and the suppression."""
        return self.record.matchings

    @property
    def phase(self) -> str | None:
        """The column of the stage angle; None where the spin was estimated."""
        return self.record.spin.phase

    @property
    def frequency(self) -> float | None:
        """Spin frequency, Hz; None where the data have no time."""
        return self.record.spin.frequency

    @property
    def provenance(self) -> PairProvenance:
        """Who made the matching, when, and from which data."""
        return self.record.provenance

    def compensation(self) -> PairCompensation:
        """Return the matched sums and the gradient signal of readings in arrays."""
        return PairCompensation(self.matchings, self.phase)

    @overload
    def apply(self, frame: Mapping[str, Any], *, columns: Mapping[str, str] | str = "") -> dict[str, Any]: ...

    @overload
    def apply(self, frame: Frame, *, columns: Mapping[str, str] | str = "") -> Frame: ...

    def apply(self, frame: Any, *, columns: Mapping[str, str] | str = "", **options: Any) -> Any:
        """Add the matched sum of each pair to a frame and, with both pairs, the gradient signal.

        Parameters
        ----------
        frame : polars.DataFrame, pandas.DataFrame, pyarrow.Table, xarray.Dataset or mapping of str to array_like
            A column for each accelerometer by its name in the pairs, and for the stage angle in degrees.
        columns : mapping of str to str, or str
            The column of each of them, such as ``{"a1": "Q1"}``; without it, the column of its name.
        **options
            Those of :meth:`tiltcal.Calibration.apply`, all of which are for tilt: one that is given is refused.

        Returns
        -------
        frame
            The same kind, with the new columns, ``flag`` and ``reason`` behind its own.

        Raises
        ------
        UsageError
            The frame is of no known kind, or has a column of a name that the result needs; or an option is for tilt.
        InputError
            A column is not there or holds no numbers.
        """
        from tiltcal.logs.apply import apply_frame

        return apply_frame(self.record, frame, complete(ApplyOptions, {"columns": columns, **options}))

    def save(self, path: str | Path) -> None:
        """Write the pair file, whole or not at all.

        Raises
        ------
        UsageError
            The file cannot be written there.
        """
        write_whole(path, dump_pair(self.record))

    def report(self, path: str | Path) -> None:
        """Write the HTML page that is filed with the accelerometers; it needs no other file, and prints on A4.

        Raises
        ------
        UsageError
            The extra ``report`` is not installed, or the page cannot be written there.
        """
        from tiltcal.report.page import write_page

        write_page(path, self.record)

    def __eq__(self, other: object) -> bool:
        """Whether both give the same file."""
        return isinstance(other, PairCalibration) and dump_pair(self.record) == dump_pair(other.record)

    def __hash__(self) -> int:
        return hash(dump_pair(self.record))

    def __repr__(self) -> str:
        pairs = ", ".join(f"{matching.pair.first} and {matching.pair.second}" for matching in self.matchings)
        return f"<PairCalibration of {pairs}>"

    def __str__(self) -> str:
        return "\n\n".join(pair_summary(matching) for matching in self.matchings)
