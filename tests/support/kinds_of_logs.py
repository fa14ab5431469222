"""Logs as loggers, phones and sketches write them, of one sensor whose truth is known; the layouts are public."""

import json
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

S = np.eye(3) + np.array([[0.010, 0.004, -0.003], [-0.006, -0.012, 0.002], [0.001, 0.005, 0.020]])
OFFSET = np.array([-0.012, 0.026, 0.019])
"""Of the sensor, g/g and g; they are made up."""
START = datetime(2026, 3, 14, 9, 30, tzinfo=UTC)

Row = tuple[int, float, datetime, np.ndarray]
"""Its number, seconds, moment, and readings, g."""


def held(still: int = 60, move: int = 30) -> np.ndarray:
    """Readings, g, of a sensor that is held in sixteen attitudes and turned between them."""
    draw = np.random.default_rng(23)
    corners = np.concatenate([np.eye(3), -np.eye(3), draw.normal(size=(10, 3))])
    corners /= np.linalg.norm(corners, axis=1)[:, None]
    rows = []
    for k, up in enumerate(corners):
        if k:
            share = np.linspace(0.0, 1.0, move)[:, None]
            rows.append((1 - share) * corners[k - 1] + share * up + 0.15 * draw.normal(size=(move, 3)))
        rows.append(np.repeat(up[None], still, axis=0))
    up = np.concatenate(rows)
    return up @ S.T + OFFSET + 0.002 * draw.normal(size=up.shape)


READINGS = held()
MS2 = 9.80665


def rows() -> Iterator[Row]:
    for k, reading in enumerate(READINGS):
        yield k, 0.01 * k, START + timedelta(seconds=0.01 * k), reading


def _numbers(a: Sequence[float], digits: int = 4, between: str = ",") -> str:
    return between.join(f"{value:.{digits}f}" for value in a)


def _sentence(text: str) -> str:
    total = 0
    for byte in text.encode():
        total ^= byte
    return f"${text}*{total:02X}"


def _ms(moment: datetime) -> str:
    return f"{moment:%H:%M:%S}.{moment.microsecond // 1000:03d}"


def _comma(text: str) -> str:
    return text.replace(".", ",")


Kind = tuple[str, Callable[[Row], str]]
"""Lines before the table, and the line of a row."""

KINDS: dict[str, Kind] = {
    "Campbell TOA5": (
        '"TOA5","CR1000X","x","1234","Std.04","CPU:x","5432","T"\n"TIMESTAMP","RECORD","Accel_X","Accel_Y","Accel_Z","B"\n'
        '"TS","RN","g","g","g","V"\n"","","Smp","Smp","Smp","Min"\n',
        lambda r: f'"{r[2]:%Y-%m-%d} {_ms(r[2])}",{r[0]},{_numbers(r[3])},"NAN"',
    ),
    "Axivity": ("", lambda r: f"{r[2]:%Y-%m-%d} {_ms(r[2])},{_numbers(r[3], 6)}"),
    "GENEActiv": (
        "Device Type,GENEActiv\n" + "".join(f"Key {k},{1.5 * k}\n" for k in range(99)),
        lambda r: f"{r[2]:%Y-%m-%d %H:%M:%S}:{r[2].microsecond // 1000:03d},{_numbers(r[3])},0,0,25.7",
    ),
    "ActiGraph": (
        "------- Data File Created By ActiGraph GT3X+ at 100 Hz -------\nSerial Number: CLE1\nEpoch Period 00:00:00\n"
        "-----\nAccelerometer X,Accelerometer Y,Accelerometer Z\n",
        lambda r: _numbers(r[3], 3),
    ),
    "Shimmer": (
        '"sep=\t"\nShimmer_A1_Unix\tShimmer_A1_Accel_LN_X_CAL\tShimmer_A1_Accel_LN_Y_CAL\tShimmer_A1_Accel_LN_Z_CAL\n'
        "ms\tm/(s^2)\tm/(s^2)\tm/(s^2)\n",
        lambda r: f"{1e3 * r[1]:.1f}\t{_numbers(MS2 * r[3], 5, chr(9))}\t",
    ),
    "Xsens": (
        "// General information:\n// Update Rate: 100.0Hz\nPacketCounter\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\n",
        lambda r: f"{r[0]:05d}\t{_numbers(MS2 * r[3], 6, chr(9))}\t0.01",
    ),
    "WitMotion": (
        "StartTime: 2026-03-14 09:30:00.000\naddress\tTime(s)\tax(g)\tay(g)\taz(g)\twx(deg/s)\tT(°C)\n",
        lambda r: f"0x50\t{r[2]:%Y-%m-%d} {_ms(r[2])}\t{_numbers(r[3], 4, chr(9))}\t0.061\t29.8",
    ),
    "EuRoC": (
        "#timestamp [ns],w_RS_S_x [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n",
        lambda r: f"{1772357400000000000 + r[0] * 10_000_000},0.01,{_numbers(MS2 * r[3], 6)}",
    ),
    "rostopic echo -p": (
        "%time,field.header.seq,field.header.frame_id,field.angular_velocity.x,field.linear_acceleration.x,"
        "field.linear_acceleration.y,field.linear_acceleration.z,field.linear_acceleration_covariance0\n",
        lambda r: f"{1772357400000000000 + r[0] * 10_000_000},{r[0]},imu,0.01,{_numbers(MS2 * r[3], 6)},0.0",
    ),
    "Klipper": ("#time,accel_x,accel_y,accel_z\n", lambda r: f"{r[1]:.6f},{_numbers(9806.65 * r[3], 6)}"),
    "Sensor Logger": (
        "time,seconds_elapsed,z,y,x\n",
        lambda r: f"{1772357400000000000 + r[0] * 10_000_000},{r[1]:.4f},{_numbers(MS2 * r[3][::-1], 6)}",
    ),
    "phyphox, German": (
        '"Zeit (s)";"Beschleunigung x (m/s^2)";"Beschleunigung y (m/s^2)";"Beschleunigung z (m/s^2)"\n',
        lambda r: _comma(f"{r[1]:.6E};{_numbers(MS2 * r[3], 6, ';')}"),
    ),
    "Matlab Mobile": ("Timestamp,X,Y,Z\n", lambda r: f"{r[2]:%d-%b-%Y} {_ms(r[2])},{_numbers(MS2 * r[3], 5)}"),
    "AndroSensor": (
        "ACCELEROMETER X (m/s²);ACCELEROMETER Y (m/s²);ACCELEROMETER Z (m/s²);Time since start in ms ;YYYY-MO-DD\n",
        lambda r: f"{_numbers(MS2 * r[3], 4, ';')};{10 * r[0]};{r[2]:%Y-%m-%d %H:%M:%S}:000",
    ),
    "Physics Toolbox": ("time,gFx,gFy,gFz,TgF\n", lambda r: f"{r[1]:.4f},{_numbers(r[3], 5)},1.000"),
    "MbientLab": (
        "epoc (ms),timestamp (-0700),elapsed (s),x-axis (g),y-axis (g),z-axis (g)\n",
        lambda r: f"{1772357400000 + 10 * r[0]},{r[2]:%Y-%m-%dT%H.%M.%S},{r[1]:.3f},{_numbers(r[3], 3)}",
    ),
    "Arduino monitor": ("", lambda r: f"{_ms(r[2])} -> {_numbers(MS2 * r[3], 2, chr(9))}"),
    "labels and bars": (
        "",
        lambda r: f"aX = {MS2 * r[3][0]:.3f} | aY = {MS2 * r[3][1]:.3f} | aZ = {MS2 * r[3][2]:.3f} | tmp = 23.40",
    ),
    "labels, three kinds of line": (
        "Adafruit MPU6050 test!\n\n",
        lambda r: (
            f"Acceleration X: {MS2 * r[3][0]:.2f}, Y: {MS2 * r[3][1]:.2f}, Z: {MS2 * r[3][2]:.2f} m/s^2\n"
            "Rotation X: -0.05, Y: 0.02, Z: -0.01 rad/s\nTemperature: 25.06 degC\n"
        ),
    ),
    "screen": (
        "[screen 0: /dev/ttyUSB0 115200]\r\nBooting v1.2\r\n",
        lambda r: "".join(f"{value:8.3f}" for value in MS2 * r[3]) + "\r",
    ),
    "HOBO": (
        '"Plot Title: test"\n"#","Date Time, GMT-05:00","X Accel, g (LGR S/N: 1, SEN S/N: 2)",'
        '"Y Accel, g (LGR S/N: 1, SEN S/N: 2)","Z Accel, g (LGR S/N: 1, SEN S/N: 2)"\n',
        lambda r: f"{r[0] + 1},{r[2]:%m/%d/%y %I:%M:%S %p},{_numbers(r[3], 4)}",
    ),
    "UTF-16, tabs, decimal comma": (
        "Zeit\tx (m/s²)\ty (m/s²)\tz (m/s²)\n",
        lambda r: _comma(f"{r[1]:.2f}\t{_numbers(MS2 * r[3], 4, chr(9))}"),
    ),
    "Windows-1252": (
        "Zeit;Temp (°C);ax (m/s²);ay (m/s²);az (m/s²)\n",
        lambda r: _comma(f"{r[1]:.2f};21.5;{_numbers(MS2 * r[3], 4, ';')}"),
    ),
    "JSON lines": (
        "",
        lambda r: json.dumps(
            {"ts": 10 * r[0], "id": "imu", "acc": dict(zip("xyz", np.round(MS2 * r[3], 4), strict=True))}
        ),
    ),
    "line of units": ("t;ax;ay;az\nms;mg;mg;mg\n", lambda r: f"{10 * r[0]};{_numbers(1e3 * r[3], 2, ';')}"),
    "comments and a header again": ("x,y,z\n", lambda r: "# mark\nx,y,z\n" * (r[0] % 500 == 7) + _numbers(MS2 * r[3])),
    "Markdown": ("| t | x | y | z |\n|---|---|---|---|\n", lambda r: f"| {r[1]:.2f} | {_numbers(r[3], 4, ' | ')} |"),
    "sentences with a check sum": ("", lambda r: _sentence(f"VNIMU,+01.06,-00.25,+03.06,{_numbers(MS2 * r[3])}")),
    "ESP-IDF": ("", lambda r: f"I ({10 * r[0]}) MPU: ax={r[3][0]:.4f}g ay={r[3][1]:.4f}g az={r[3][2]:.4f}g"),
    "LabVIEW": (
        "Separator\tTab\nSamples\t9\t9\t9\nY_Unit_Label\tg\tg\tg\n***End_of_Header***\t\t\t\nX_Value\tax\tay\taz\tComment\n",
        lambda r: f"{r[1]:.6f}\t{_numbers(r[3], 6, chr(9))}\t",
    ),
    "MQTT": (
        "",
        lambda r: "imu/accel {'x': %.4f, 'y': %.4f, 'z': %.4f}" % tuple(MS2 * r[3]),  # noqa: UP031
    ),
    "decimal commas in quotes": (
        '"Zeit","Xa","Ya","Za"\n',
        lambda r: ",".join(f'"{_comma(f"{v:.4f}")}"' for v in (r[1], *r[3])),
    ),
    "Betaflight": (
        '"loopIteration","accSmooth[0]","accSmooth[1]","accSmooth[2]"\n',
        lambda r: f"{r[0]},{_numbers(r[3], 5)}",
    ),
    "brackets": ("", lambda r: f"[{_numbers(MS2 * r[3], 3, ', ')}]"),
    "numpy.savetxt": ("# t x y z\n", lambda r: f"{r[1]:.18e} {_numbers(MS2 * r[3], 12, ' ')}"),
}
ENCODINGS = {"UTF-16, tabs, decimal comma": "utf-16", "Windows-1252": "cp1252"}
"""Where it is not UTF-8."""
UNNAMED = {"GENEActiv": "x=2,y=3,z=4", "sentences with a check sum": "x=5,y=6,z=7"}
"""What a person must say of a log that names nothing and has more than three numbers."""


def write_kind(name: str, path: Path) -> None:
    """Write a log of a kind."""
    head, row = KINDS[name]
    path.write_bytes((head + "".join(f"{row(one)}\n" for one in rows())).encode(ENCODINGS.get(name, "utf-8")))
