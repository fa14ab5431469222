"""Lines as sketches print them: what is read, what is guessed, and what a session on such a port says."""

from collections.abc import Callable
from itertools import count, cycle

from support.command import tiltcal
from support.pty_device import printing

from tiltcal.column_guess import guess
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address

PRINTED = {
    "X: 1.55 Y: -0.09 Z: 10.49": ("x,y,z", ""),
    "X: 1.55 \tY: -0.09 \tZ: 10.49 \tm/s^2 ": ("x,y,z", "m/s2"),
    "Acceleration X: 0.1, Y: 0.2, Z: 9.7 m/s²": ("x,y,z", "m/s2"),
    "0.1,0.2,9.8": ("x,y,z", "m/s2"),
    "12:34:56.789 -> -12 7 16384": ("x,y,z", "count"),
    "0.05 | -0.08 | 0.15 | 0.02 | -0.13 | 0.99": ("-,-,-,x,y,z", "g"),
    "ax=12 ay=3 az=16384 gx=1 gy=2 gz=3": ("x,y,z,-,-,-", ""),
    "Temp: 24.5 C, ax: 0.1 g, ay: 0.2 g, az: 0.9 g": ("temperature,x,y,z", "g"),
    '{"t": 12, "acc": {"x": 0.1, "y": 0.2, "z": 9.8}}': ("-,x,y,z", "m/s2"),
    "1.5 2 3 4 5": ("-,-,-,-,-", ""),
}
"""Each with the columns and the unit that it shows to a person."""


def test_lines_are_read_as_they_are_printed_and_guessed() -> None:
    for line, (columns, unit) in PRINTED.items():
        guessed = guess(["starting ...", line, line])
        assert (",".join(guessed.roles), guessed.unit) == (columns, unit), line
        if "x" in columns:
            address = parse_address(f"serial:///dev/null?columns={columns}")
            layout = find_model("serial-columns").at(address).driver.args[0]
            assert layout.reading(line.encode()) is not None, line
    assert guess(["ax,ay,az,temp", "1,2,3,4"]).roles == ("x", "y", "z", "temperature")
    assert guess(["0,30,40", "20,31,41", "40,32,42"]).roles == ("x", "y", "z")  # too few to tell a clock
    assert not guess(["hello"]).roles
    layout = find_model("serial-columns").at(parse_address("serial:///dev/null?columns=x,y,z")).driver.args[0]
    for torn in (
        b"X: 1.55 Y: -0.09",
        b"X: 1.55 Y: -0.09 Z: ",
        b"Y: -0.09 X: 1.55 Z: 9.49",
        b"X: 1.55 Y: -0X: 1.5 Z: 2",
        b"1,2,3x",
        b"-> 1,2,3",
        b"Z: nan 1 2",
        b"1,2,3\x07",
        b'{"x": 1, "y": 2, "z": 3',
        b"[" * 100_000,
    ):
        assert layout.reading(torn) is None, torn


def lines_of(*lines: bytes) -> Callable[[], bytes]:
    rows = cycle(lines)
    return lambda: next(rows)


def test_a_port_alone_is_listened_to_and_the_advice_works() -> None:
    sketch = lines_of(b"X: 1.55 \tY: -0.09 \tZ: 9.49 \tm/s^2 \r\n", b"X: 1.57 \tY: -0.07 \tZ: 9.51 \tm/s^2 \r\n")
    with printing(sketch, 50.0, waits=False) as port:
        said = tiltcal("probe", "--address", port)
        assert said.returncode == 0, said.stderr
        assert "prints 3 numbers a line" in said.stdout
        advised = said.stdout.splitlines()[-1].split('"')[1]
        assert advised == f"{port}?columns=x,y,z&unit=m/s2"
        done = tiltcal("probe", "--sensor", "serial-columns", "--address", advised)
        assert done.returncode == 0, done.stderr
        assert "9.5" in done.stdout or "9.49" in done.stdout
        swapped = tiltcal("probe", "--sensor", "serial-columns", "--address", advised.replace("x,y,z", "y,x,z"))
        assert "the label 'X' of " in swapped.stderr
        assert "contradicts columns=y,x,z" in swapped.stderr
    nine = b",".join(b"%d.25" % (7 * k) for k in range(9)) + b"\r\n"
    with printing(lines_of(nine, nine.replace(b"25", b"75")), 50.0, waits=False) as port:
        advised = tiltcal("probe", "--address", f"{port}?timeout=3").stdout.splitlines()[-1].split('"')[1]
        assert advised == f"{port}?timeout=3&columns=x,y,z,-,-,-,-,-,-&unit=m/s2"
    with printing(lines_of(b"$PTCDC,17,40960,38912,80000,80000,23.9*4C\r\n"), 50.0, waits=False) as port:
        assert "--sensor adxl202" in tiltcal("probe", "--address", port).stderr
    assert "--sensor is missing" in tiltcal("probe", "--address", "spi:///dev/spidev0.0").stderr
    counter = count()
    with printing(lambda: b"%d,0.12,-0.34,9.71\r\n" % (1000 + 20 * next(counter)), 50.0, waits=False) as port:
        said = tiltcal("probe", "--sensor", "serial-columns", "--address", port).stdout
    assert "as columns=-,x,y,z, unit=m/s2 (at rest they are as long as gravity)" in said
