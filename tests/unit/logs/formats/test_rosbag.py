"""Bags of ROS, written by the package ``rosbags``: fitted, applied, characterised; what is wrong is named."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from support.command import tiltcal

import tiltcal as library
from tiltcal.logs.formats import open_log

pytest.importorskip("rosbags", reason="the rosbags package is not installed")

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

OFFSET, SCALE = np.array([0.15, -0.2, 0.3]), 9.80665 * np.array([1.02, 0.99, 1.01])
"""Of the virtual sensor of these bags, m/s² and m/s² per g."""


def bag(folder: Path, rows: np.ndarray, topics: tuple[str, ...] = ("/imu",)) -> Path:
    """Write rows of accelerations, 100 a second from a moment on, as messages; the path of the .mcap file."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    still = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [writer.add_connection(topic, "sensor_msgs/msg/Imu", typestore=store) for topic in topics]
        for number, row in enumerate(rows):
            moment = 1_700_000_000 * 10**9 + number * 10**7
            stamp = types["builtin_interfaces/msg/Time"](moment // 10**9, moment % 10**9)
            header = types["std_msgs/msg/Header"](stamp, "base")
            rate, force = vector(0.0, 0.0, 0.25), vector(*map(float, row))
            message = types["sensor_msgs/msg/Imu"](header, still, zeros, rate, zeros, force, zeros)
            writer.write(connections[-1], moment, store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
    return next(folder.glob("*.mcap"))


def held(attitudes: int, rows: int) -> np.ndarray:
    """Readings of a sensor that is held still in attitudes of all directions, with motion between them."""
    rng = np.random.default_rng(5)
    up = rng.normal(size=(attitudes, 3))
    up[:6] = np.vstack([np.eye(3), -np.eye(3)])
    up /= np.linalg.norm(up, axis=1)[:, None]
    still = np.repeat(up * SCALE + OFFSET, rows, axis=0).reshape(attitudes, rows, 3)
    still += rng.normal(0.0, 0.01, still.shape)
    moving = still[:, -60:] + rng.normal(0.0, 3.0, (attitudes, 60, 3))
    return np.concatenate([still, moving], axis=1).reshape(-1, 3)


def test_a_bag_is_fitted_and_applied(tmp_path: Path) -> None:
    run = bag(tmp_path / "run", held(16, 200))
    done = tiltcal("fit", "free", run, "--unit", "m/s2", "--serial", "R-1", "-o", "R-1.yaml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    cal = library.read(tmp_path / "R-1.yaml")
    for axis, offset, scale in zip("xyz", OFFSET, SCALE, strict=True):
        assert cal.offset[axis] == pytest.approx(offset, abs=0.005)
        assert cal.sensitivity[axis, axis] == pytest.approx(scale, abs=0.005)
    done = tiltcal("apply", "R-1.yaml", run, "-o", "out.parquet", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    out = pl.read_parquet(tmp_path / "out.parquet")
    rates = np.tile([0.0, 0.0, 0.25], (16 * 260, 1))
    time = 1_700_000_000.0 + 0.01 * np.arange(16 * 260.0)
    np.testing.assert_allclose(out.to_numpy()[:, :7], np.column_stack([time, held(16, 200), rates]), rtol=1e-15)
    assert out["g_x"][:200].mean() == pytest.approx(1.0, abs=1e-3)
    folder = tiltcal("apply", "R-1.yaml", "run", "-o", "folder.csv", cwd=tmp_path)
    assert folder.returncode == 0, folder.stderr
    assert len((tmp_path / "folder.csv").read_text().splitlines()) == 1 + 16 * 260


def test_a_topic_is_named_where_there_are_several(tmp_path: Path) -> None:
    run = bag(tmp_path / "run", np.random.default_rng(1).normal((0, 0, 9.8), 0.01, (2000, 3)), ("/raw", "/imu/data"))
    refused = tiltcal("noise", run, "--unit", "m/s2")
    assert refused.returncode == 2
    assert "name one, --topic /imu/data or /raw" in refused.stderr
    done = tiltcal("noise", run, "--topic", "/imu/data", "--unit", "m/s2")
    assert done.returncode == 0, done.stderr
    assert "2000 samples of x, y, z, 0.01 s apart" in done.stdout
    assert "there is no topic '/gps'" in tiltcal("noise", run, "--topic", "/gps", "--unit", "m/s2").stderr
    assert "topic /raw has no message" in tiltcal("noise", run, "--topic", "/raw", "--unit", "m/s2").stderr
    whole = run.read_bytes()
    for name, content in {"cut.mcap": whole[: len(whole) // 2], "text.mcap": b"time,x\n", "empty.bag": b""}.items():
        (tmp_path / name).write_bytes(content)
        damaged = tiltcal("noise", tmp_path / name, "--unit", "m/s2")
        assert damaged.returncode == 2, name
        assert "damaged or truncated" in damaged.stderr, name
    assert tiltcal("noise", tmp_path / "none.mcap", "--unit", "m/s2").stderr.endswith("none.mcap: no such file\n")


def test_a_length_beyond_all_memory_is_damage(tmp_path: Path) -> None:
    """Of 16 TB, at places in the summary at the end of a bag."""
    run, said = bag(tmp_path / "run", np.zeros((3, 3))), []
    whole = run.read_bytes()
    for place in range(len(whole) - 500, len(whole), 5):
        run.write_bytes(whole[:place] + (2**44).to_bytes(8, "little") + whole[place + 8 :])
        try:
            with open_log(run) as log:
                list(log.rows([0, 1]))
        except library.InputError as error:
            said.append(str(error))
    assert sum("a length in it is beyond all memory" in text for text in said) >= 3
