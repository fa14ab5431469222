"""``python:`` and ``iio:`` read what they name, say what fails, and a replay needs neither."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.command import tiltcal

import tiltcal as library
from tiltcal.drivers.bus import attributes
from tiltcal.errors import BusError, DeviceFault, HardwareError, UsageError

MODULE = '''
import itertools, json, pathlib

class Imu:
    """As CircuitPython's drivers are."""

    @property
    def acceleration(self):
        return tuple(json.loads(pathlib.Path("attitude.json").read_text()))

def broken():
    raise OSError("no such bus")

def numbers():
    return 0.5, -0.25, 9.75

def reader():
    return numbers
'''


@pytest.fixture
def imu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_modules: None) -> Path:
    (tmp_path / "imu.py").write_text(MODULE)
    (tmp_path / "attitude.json").write_text("[1.5, -2.25, 9.375]")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_object_of_python_is_read(imu: Path) -> None:
    for factory, values in {
        "Imu": (1.5, -2.25, 9.375),
        "reader": (0.5, -0.25, 9.75),
        "numbers": (0.5, -0.25, 9.75),
    }.items():
        with library.open_sensor("python", f"python:imu:{factory}") as sensor:
            assert sensor.read().values == values, factory
    (imu / "attitude.json").write_text("[1.5, -2.25]")
    refused = {
        "python:imu:Imu": (BusError, "not the numbers x,y,z"),
        "python:imu:broken": (HardwareError, "broken failed .OSError: no such bus"),
        "python:imu:missing": (UsageError, "module imu has no missing"),
        "python:nothing_of_this_name:open": (HardwareError, "cannot be imported"),
        "python:imu": (UsageError, "name a module and what it calls"),
    }
    for address, (error, why) in refused.items():
        with pytest.raises(error, match=why), library.open_sensor("python", address) as sensor:
            sensor.read()


def test_a_replay_imports_no_object(imu: Path) -> None:
    """Six faces of an ideal sensor: the program sets its attitude where it is asked; the file is there without it."""

    class Table:
        def position(self, ask: dict) -> dict:
            (imu / "attitude.json").write_text(str([9.80665 * one + 0.01 for one in ask["gravity"]]))
            return {"answer": "ready"}

    cal = library.measure(
        "six-face", sensor="python", address="python:imu:Imu", serial="P-1", operator=Table(), jig=0.1, samples=5,
        settle=0.1, output="P-1.yaml",
    )  # fmt: skip
    assert cal.offset["x"] == pytest.approx(0.01, abs=1e-3)
    assert cal.sensitivity["z", "z"] == pytest.approx(9.80665, abs=1e-3)
    (imu / "imu.py").unlink()
    sys.modules.pop("imu", None)
    done = tiltcal("replay", "P-1.journal.jsonl", "--golden", "P-1.yaml", cwd=imu)
    assert done.returncode == 0, done.stderr
    assert "imu" not in sys.modules


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The attributes that st_accel gives of a LIS3DH at ±2 g."""
    folder = tmp_path / "iio:device0"
    folder.mkdir()
    attributes_of = {
        "name": "lis3dh_accel", "in_accel_x_raw": "-120", "in_accel_y_raw": "64", "in_accel_z_raw": "1008",
        "in_accel_scale": "0.009582", "sampling_frequency": "100", "in_accel_mount_matrix": "1, 0, 0; 0, 1, 0; 0, 0, 1",
    }  # fmt: skip
    for name, text in attributes_of.items():
        (folder / name).write_text(f"{text}\n")
    monkeypatch.setattr(attributes, "SYSFS", tmp_path)
    return folder


def test_an_accelerometer_of_linux_is_read_in_one_setting(device: Path) -> None:
    with library.open_sensor("iio", "iio:device0") as sensor:
        said = sensor.probe()
        assert said["name"] == "lis3dh_accel"
        assert "sensitivity=1023.4" in said["scale"]
        assert said["mount matrix"].startswith("1, 0, 0")
        for _ in range(24):
            assert sensor.read().values == (-120.0, 64.0, 1008.0)
        (device / "in_accel_scale").write_text("0.019163\n")
        with pytest.raises(DeviceFault, match=r"scale of the device was 0.009582 and is 0.019163"):
            sensor.read()


def test_what_is_no_accelerometer_of_linux_is_named(device: Path) -> None:
    for address, error, why in (
        ("iio:device7", BusError, "devices there: device0"),
        ("iio:accel", UsageError, "name a device"),
        ("iio:ip:192.0.2.1/device0", HardwareError, "libiio"),
    ):
        with pytest.raises(error, match=why), library.open_sensor("iio", address) as sensor:
            sensor.read()
    for name, content, why in (
        ("in_accel_y_raw", b"\xff", r"iio:device0: reading in_accel_y_raw failed \(UnicodeDecodeError"),
        ("name", b"\n", "the device names itself '': is it one"),
    ):
        (device / name).write_bytes(content)
        with pytest.raises(BusError, match=why), library.open_sensor("iio", "iio:device0") as sensor:
            sensor.read()


def test_an_accelerometer_of_another_machine_is_read_by_libiio(monkeypatch: pytest.MonkeyPatch) -> None:
    """As libiio's Python package has it: attributes by name, of the device and of its channels."""

    def attribute(filename: str, value: str) -> tuple[str, SimpleNamespace]:
        return filename, SimpleNamespace(filename=filename, value=value)

    channels = {
        f"accel_{axis}": SimpleNamespace(attrs=dict([attribute(f"in_accel_{axis}_raw", raw)]))
        for axis, raw in (("x", "-12"), ("y", "7"), ("z", "1008"))
    }
    there = SimpleNamespace(
        name="adxl345", attrs=dict([attribute("in_accel_scale", "0.0383")]), find_channel=channels.__getitem__
    )

    def context(host: str) -> SimpleNamespace:
        if host == "ip:192.0.2.9":
            raise OSError("timed out")
        return SimpleNamespace(find_device=lambda device: there if (host, device) == ("ip:pi", "iio:device1") else None)

    monkeypatch.setitem(sys.modules, "iio", SimpleNamespace(Context=context))
    with library.open_sensor("iio", "iio:ip:pi/device1") as sensor:
        assert sensor.read().values == (-12.0, 7.0, 1008.0)
        assert sensor.probe()["scale"].startswith("0.0383")
    for address, why in (
        ("iio:ip:192.0.2.9/device1", r"no iiod answers at ip:192\.0\.2\.9 \(timed out\): is it running"),
        ("iio:ip:pi/device2", "ip:pi has no iio:device2: 'iio_info -u ip:pi' lists what it has"),
    ):
        with pytest.raises(BusError, match=why), library.open_sensor("iio", address):
            pass


def test_a_whole_session_reads_an_accelerometer_of_linux(device: Path, tmp_path: Path) -> None:
    class Table:
        def position(self, ask: dict) -> dict:
            for axis, g in zip("xyz", ask["gravity"], strict=True):
                (device / f"in_accel_{axis}_raw").write_text(f"{round(1000 * g) + 20}\n")
            return {"answer": "ready"}

    cal = library.measure(
        "six-face", sensor="iio", address="iio:device0?sensitivity=1000", serial="I-1", operator=Table(), jig=0.1,
        samples=30, settle=0.1, output=tmp_path / "I-1.yaml",
    )  # fmt: skip
    assert cal.offset["x"] == pytest.approx(20.0, abs=0.5)
    assert cal.sensitivity["z", "z"] == pytest.approx(1000.0, abs=0.5)
