"""Chunks of a NetCDF log that are packed in threads, against the library, which unpacks them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from tiltcal.logs.formats.netcdf import _write_chunks


@pytest.mark.parametrize("shuffle", [True, False])
@pytest.mark.parametrize("rows", [300, 1000, 2500])
def test_the_library_unpacks_what_was_packed(tmp_path: Path, rows: int, shuffle: bool) -> None:
    rng = np.random.default_rng(5)
    columns = {
        "tilt_x": np.where(rng.random(rows) < 0.1, np.nan, rng.normal(0.0, 30.0, rows)),
        "u_tilt_x": np.round(rng.uniform(0.1, 0.2, rows), 4),
        "flag": rng.integers(1, 10, rows).astype(np.uint8),
    }
    with h5py.File(tmp_path / "log.nc", "w") as file:
        variables = {
            name: SimpleNamespace(
                _h5ds=file.create_dataset(
                    name, rows, column.dtype, chunks=(min(rows, 1000),), compression=1, shuffle=shuffle
                )
            )
            for name, column in columns.items()
        }
        starts = range(0, rows, 1000)
        tables = ({name: column[start : start + 1000] for name, column in columns.items()} for start in starts)
        _write_chunks(variables, tables, min(rows, 1000), lambda: None)
    with h5py.File(tmp_path / "log.nc") as file:
        for name, column in columns.items():
            np.testing.assert_array_equal(file[name][:], column)


def test_chunks_do_not_wait_in_memory_for_the_end_of_a_log(tmp_path: Path) -> None:
    """What is packed and not yet written is four chunks, however long the log is."""
    with h5py.File(tmp_path / "log.nc", "w") as file:
        dataset = file.create_dataset("tilt_x", 4000, float, chunks=(100,), compression=1, shuffle=True)

        def tables() -> Iterator[dict[str, NDArray[np.float64]]]:
            for number in range(40):
                assert dataset.id.get_num_chunks() >= number - 4
                yield {"tilt_x": np.full(100, float(number))}

        _write_chunks({"tilt_x": SimpleNamespace(_h5ds=dataset)}, tables(), 100, lambda: None)
        assert dataset.id.get_num_chunks() == 40


def test_ctrl_c_is_heard_between_two_blocks(tmp_path: Path) -> None:
    asked = iter([None, KeyboardInterrupt])

    def check_interrupts() -> None:
        if (why := next(asked)) is not None:
            raise why

    with h5py.File(tmp_path / "log.nc", "w") as file:
        dataset = file.create_dataset("tilt_x", 400, float, chunks=(100,), compression=1, shuffle=True)
        tables = ({"tilt_x": np.full(100, float(number))} for number in range(4))
        with pytest.raises(KeyboardInterrupt):
            _write_chunks({"tilt_x": SimpleNamespace(_h5ds=dataset)}, tables, 100, check_interrupts)
        assert next(tables)["tilt_x"][0] == 2.0
