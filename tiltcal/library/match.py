"""From recorded data to the matching of accelerometer pairs: the library's ``match``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from tiltcal.library.pair_calibration import PairCalibration
from tiltcal.logs.match import match_log, pairs_of


def match(
    data: Any,
    pairs: Sequence[tuple[str, str, str]],
    *,
    phase: str | None = None,
    online: bool = False,
    loops: bool = False,
    skip_bad_rows: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> PairCalibration:
    """Match pairs of accelerometers on a turning stage: scale factor p and misalignment q.

    Parameters
    ----------
    data : str, Path or frame
        A log (CSV, Parquet or NetCDF-4), or a frame of its columns.
    pairs : sequence of (str, str, str)
        One or two pairs: the columns of the first and the second accelerometer, and of one a quarter turn away.
    phase : str, optional
        The column of the stage angle, degrees. Without it the spin is estimated from the readings and the column
        ``time``.
    online : bool
        Estimate turn by turn, as on a live stream; it takes the ``phase``.
    loops : bool
        With ``online``: by the two PID loops of the source, not the recursive estimator.
    skip_bad_rows : bool
        Leave out rows of a log that cannot be parsed, instead of raising.
    say : callable, optional
        Called with each remark about the data.

    Returns
    -------
    PairCalibration

    Raises
    ------
    UsageError
        The pairs are not pairs.
    InputError
        A column is missing or has no values, or a row cannot be parsed.
    EstimateError
        The stage does not turn as it must.

    Examples
    --------
    >>> print(tiltcal.match("disk.csv", [("a1", "a2", "a4")], phase="theta"))
    """
    matched = match_log(
        data, pairs_of(pairs), phase=phase, online=online, loops=loops, skip_bad_rows=skip_bad_rows, say=say
    )
    return PairCalibration(matched.calibration)
