"""The rows of a log in a temporary file."""

from __future__ import annotations

import errno
import os
from tempfile import SpooledTemporaryFile, gettempdir

import numpy as np
import pytest

from tiltcal.errors import UsageError
from tiltcal.logs.stored_rows import StoredRows


def test_a_slice_has_the_rows_that_were_stored() -> None:
    rows = np.arange(12.0).reshape(3, 4)
    with StoredRows(3, shown=2) as stored:
        stored.append(rows[:, :1])
        stored.append(rows[:, 1:])
        np.testing.assert_array_equal(stored[1:3], rows[:2, 1:3].T)
        np.testing.assert_array_equal(np.concatenate(list(stored.blocks()), axis=1), rows)


def test_a_full_disk_names_the_folder_and_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_file: object, _data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(SpooledTemporaryFile, "write", full)
    with StoredRows(1) as stored, pytest.raises(UsageError) as raised:
        stored.append(np.zeros((1, 1)))
    assert gettempdir() in str(raised.value)
    assert "No space left on device" in str(raised.value)
    assert "TMPDIR" in str(raised.value)
