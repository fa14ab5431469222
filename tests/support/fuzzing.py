"""Damaged input for every reader, driver and command: each ends in a result or in an error of ours.

An input is known by the name of its target, a seed and a number. Targets that a library in C or Rust parses are
``compiled``: their damage may end the process, which is counted and is no failure of ours. Run as a script this module
is a worker that tries inputs and says how each ended.
"""

from __future__ import annotations

import json
import os
import re
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, suppress
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parents[1]))

from support import FIXTURES
from support.command import tiltcal
from support.damage import WORDS, damaged_bytes, damaged_journal, damaged_text, damaged_yaml
from tiltcal.errors import TiltcalError

SECONDS = 10
"""Of processor time; a worker that waits for longer than a minute is ended."""

BATCH = 2000
"""Inputs that one worker tries before the next one starts."""

MEGABYTES = 1000
ENDED = "ended by its library"
FAILED = "failed"
RESULT = "result"
OURS = "our error"

Body = Callable[[Random], object]


class TooSlow(BaseException):
    """An input took longer than it may."""


@dataclass(frozen=True)
class Target:
    """What is given damaged input, in an empty folder of its own; an exit code that it returns is checked."""

    body: Body
    compiled: bool = False


TARGETS: dict[str, Target] = {}


def target(*, compiled: bool = False) -> Callable[[Body], Body]:
    def register(body: Body) -> Body:
        TARGETS[body.__name__] = Target(body, compiled)
        return body

    return register


def attempt(name: str, seed: int, number: int) -> tuple[str, str]:
    """Try an input, and return how it ended and what there is to say of it."""
    draw = Random(f"{seed}/{name}/{number}")
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, chdir(folder):
        alarm = signal.signal(signal.SIGPROF, _too_slow)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            TARGETS[name].body(draw)
        except TiltcalError:
            return OURS, ""
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            return FAILED, "".join(traceback.format_exception(error)[-8:])
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, alarm)
        return RESULT, ""


def _too_slow(*_: object) -> None:
    raise TooSlow(f"longer than {SECONDS} s")


def run(*arguments: str) -> int:
    """Call the command line; an error of ours is raised as one, another exit code than the documented ones fails."""
    done = tiltcal(*arguments)
    if done.returncode in (2, 3):
        if not re.search(r"^(tiltcal: |Error: |Usage: )", done.stderr, re.MULTILINE):
            raise AssertionError(f"exit code {done.returncode} without a reason: {done.stderr!r}")
        raise TiltcalError(done.stderr)
    if done.returncode not in (0, 1):
        raise AssertionError(f"exit code {done.returncode}: {done.stderr}")
    return done.returncode


def golden(name: str) -> str:
    return (FIXTURES / name).read_text(encoding="utf-8")


# Files in YAML


CALIBRATIONS = ("plane", "complete", "six-face", "free", "mounting", "temperature-sweep", "multi-angle", "mavs")


@target()
def calibration(draw: Random) -> None:
    Path("c.yaml").write_bytes(damaged_yaml(draw, golden(f"{draw.choice(CALIBRATIONS)}.yaml")))
    run("check", "c.yaml")
    Path("log.csv").write_text("x,y,z,temperature\n1024,1024,1024,20\n1500,900,1100,\n")
    run(
        *draw.choice(
            (
                ("apply", "c.yaml", "log.csv", "-o", "out.csv"),
                ("apply", "c.yaml", "log.csv", "-o", "out.csv", "--uncertainty"),
                ("diff", "c.yaml", str(FIXTURES / "plane.yaml")),
                ("report", "c.yaml", "-o", "c.html"),
                ("verify", "c.yaml", "--address", "sim:", "--operator", "sim"),
            )
        )
    )


@target()
def pair(draw: Random) -> None:
    Path("p.yaml").write_bytes(damaged_yaml(draw, golden("rotation.yaml")))
    run("check", "p.yaml")
    Path("log.csv").write_text("time,theta,a1,a2,a3,a4\n" + "".join(f"{k},{k * 9},1,2,3,{k}\n" for k in range(50)))
    run(*draw.choice((("apply", "p.yaml", "log.csv", "-o", "out.csv"), ("report", "p.yaml", "-o", "p.html"))))


@target()
def procedure(draw: Random) -> None:
    shipped = sorted((FIXTURES.parent / "procedures").glob("*.yaml"))
    Path("p.yaml").write_bytes(damaged_yaml(draw, draw.choice(shipped).read_text(encoding="utf-8")))
    run("check", "p.yaml")
    run(*draw.choice((("procedures", "./p.yaml"), ("plan", "./p.yaml", "--sensor", "sca100t-d02", "--jig", "0.1"))))


BENCH = """\
tiltcal: 1
kind: bench
operator: A. Technician
jig: 0.05
sensors:
  - {serial: A, model: sca100t-d02, address: "sim:seed=1", axes: [x, -y]}
  - {serial: B, model: sca3000-d01, address: "sim:seed=2", axes: [y, -x, z]}
thermometer: {model: thermistor, address: "sim:"}
"""


@target()
def bench(draw: Random) -> None:
    Path("b.yaml").write_bytes(damaged_yaml(draw, BENCH))
    run("check", "b.yaml")
    if "sim:" in Path("b.yaml").read_text(errors="replace"):
        run("record", "--bench", "b.yaml", "--rows", "3", "-o", "log.csv")


@target()
def twin(draw: Random) -> None:
    file = draw.choice(sorted((FIXTURES / "twins").glob("*.yaml")))
    model = re.search(r"^model: (\S+)", file.read_text(encoding="utf-8"), re.MULTILINE)
    Path("t.yaml").write_bytes(damaged_yaml(draw, file.read_text(encoding="utf-8")))
    run("check", "t.yaml")
    run(
        "record",
        "--sensor",
        model[1] if model else "sca3000-d01",
        "--address",
        "sim:twin=t.yaml",
        "--rows",
        "3",
        "-o",
        "l.csv",
    )


# Journals


JOURNALS = ("zero-45", "plane", "two-temperature", "verify", "reversal", "six-face")


@target()
def journal(draw: Random) -> None:
    name = draw.choice(JOURNALS)
    Path("j.journal.jsonl").write_bytes(damaged_journal(draw, (FIXTURES / f"{name}.journal.jsonl").read_bytes()))
    run("check", "j.journal.jsonl")
    if draw.random() < 0.7:
        run("replay", "j.journal.jsonl", "-o", "again.yaml")
    else:
        run("measure", "--resume", "j.journal.jsonl", "--operator", "sim")


# Tables and texts


LOG = "time,x,y,z,temperature,theta\n" + "".join(
    f"{k * 0.1:.1f},{x + 0.001 * (k % 7)},{y - 0.001 * (k % 5)},{z + 0.0007 * (k % 3)},20,{27 * k}\n"
    for k, (x, y, z) in enumerate(
        one for face in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)) for one in [face] * 30
    )
)
SEGMENTS = "position,start,end\n" + "".join(
    f"{name},{30 * k},{30 * k + 30}\n" for k, name in enumerate(("x-up", "x-down", "y-up", "y-down", "z-up", "z-down"))
)
TABLE = (
    "position,x,y,ux,uy\nx-tilt1,3.5,2.5,1e-3,1e-3\nx-tilt2,1.5,2.5,1e-3,1e-3\n"
    "y-tilt1,2.5,3.5,1e-3,1e-3\ny-tilt2,2.5,1.5,1e-3,1e-3\n"
)


def damaged_table(draw: Random, text: str) -> bytes:
    if draw.random() < 0.4:
        return damaged_bytes(draw, text.encode())
    return damaged_text(draw, text).encode(errors="replace")


@target()
def segments(draw: Random) -> None:
    Path("log.csv").write_text(LOG)
    Path("s.csv").write_bytes(damaged_table(draw, SEGMENTS))
    run("fit", "six-face", "log.csv", "--segments", "s.csv", "--unit", "g", "--serial", "S", "-o", "s.yaml")


@target()
def segments_json(draw: Random) -> None:
    Path("log.csv").write_text(LOG)
    rows = [dict(zip(("position", "start", "end"), row.split(","), strict=True)) for row in SEGMENTS.split()[1:]]
    text = json.dumps([row | {"start": int(row["start"]), "end": int(row["end"])} for row in rows])
    Path("s.json").write_bytes(damaged_yaml(draw, text) if draw.random() < 0.3 else _damaged_json(draw, text))
    run("fit", "six-face", "log.csv", "--segments", "s.json", "--unit", "g", "--serial", "S", "-o", "s.yaml")


def _damaged_json(draw: Random, text: str) -> bytes:
    from support.damage import damaged_value

    return json.dumps(damaged_value(draw, json.loads(text))).encode()


@target()
def table(draw: Random) -> None:
    Path("t.csv").write_bytes(damaged_table(draw, TABLE))
    run("fit", "plane", "t.csv", "--table", "--unit", "V", "--serial", "S", "-o", "s.yaml")


@target()
def columns(draw: Random) -> None:
    Path("log.csv").write_text("VoutX,VoutY,T,when\n1024,1024,20,0\n1030,1020,20,1\n")
    named = damaged_text(draw, "x=VoutX,y=VoutY,temperature=T,time=when")
    run("apply", str(FIXTURES / "plane.yaml"), "log.csv", "--columns", named, "-o", "out.csv")


@target()
def csv(draw: Random) -> None:
    Path("log.csv").write_bytes(damaged_table(draw, LOG))
    plane = str(FIXTURES / "plane.yaml")
    run(
        *draw.choice(
            (
                ("apply", plane, "log.csv", "-o", "out.csv"),
                ("apply", plane, "log.csv", "-o", "out.csv", "--skip-bad-rows"),
                ("apply", plane, "log.csv", "-o", "out.parquet", "--uncertainty"),
                ("fit", "free", "log.csv", "--unit", "g", "--serial", "S", "-o", "s.yaml"),
                ("noise", "log.csv", "--rate", "10", "--unit", "g"),
                ("match", "log.csv", "--pair", "x,y", "--orthogonal", "z", "--phase", "theta", "-o", "p.yaml"),
                ("report", plane, "log.csv", "-o", "r.html"),
            )
        )
    )


@target()
def address(draw: Random) -> None:
    from tiltcal.drivers import models
    from tiltcal.drivers.bus.address import parse_address

    model = draw.choice(list(models()))
    text = draw.choice((*model.addresses, "sim:seed=1", "sim:twin=t.yaml&seed=2"))
    text = (
        damaged_text(draw, text) if draw.random() < 0.8 else damaged_bytes(draw, text.encode()).decode(errors="replace")
    )
    where = parse_address(text)
    model.at(where)
    if where.simulated:
        run("probe", "--sensor", model.name, "--address", text)


@target()
def answer(draw: Random) -> None:
    from tiltcal.bench.operators.json_lines import parsed
    from tiltcal.bench.operators.rig import understood

    text = '{"answer": "ready", "tilt": {"x": 30.0}, "gravity": [0, 0.5, 0.866], "temperature": 20.5}'
    way = draw.choice((damaged_bytes, lambda draw, data: damaged_text(draw, data.decode()).encode(errors="replace")))
    for line in (way(draw, text.encode()), _damaged_json(draw, text)):
        with suppress(TiltcalError):
            understood(parsed(line.decode(errors="replace")))


# Commands


@cache
def options_of(command: str) -> Sequence[tuple[list[str], bool]]:
    """Return the names of a command's options, and whether each takes a value."""
    from tiltcal.cli.main import group

    known = group.get_command(group.make_context("tiltcal", [command]), command)
    assert known is not None
    return [
        (list(one.opts), not getattr(one, "is_flag", False)) for one in known.params if one.param_type_name == "option"
    ]


STARTS = {
    "devices": "devices",
    "procedures": "procedures plane",
    "probe": "probe --sensor sca100t-d02 --address sim:",
    "plan": "plan plane --sensor sca100t-d02 --jig 0.1",
    "measure": "measure plane --sensor sca100t-d02 --address sim: --serial S --operator sim --samples 5 -o s.yaml",
    "record": "record --sensor sca100t-d02 --address sim: --rows 5 -o log.csv",
    "verify": "verify plane.yaml --address sim: --operator sim --samples 5",
    "diff": "diff plane.yaml complete.yaml",
    "fit": "fit six-face faces.csv --segments segments.csv --unit g --serial S -o s.yaml",
    "apply": "apply plane.yaml log.csv -o out.csv",
    "noise": "noise log.csv --unit count --rate 10",
    "match": "match log.csv --pair x,y --orthogonal z --phase theta",
    "report": "report plane.yaml -o r.html",
    "check": "check plane.yaml",
    "replay": "replay zero-45.journal.jsonl -o again.yaml",
}
ENDLESS = {
    "--samples",
    "--rows",
    "--for",
    "--settle",
    "--rate",
    "--turns",
    "--target",
    "--scheduler",
    "--workers",
    "--address",
}


@target()
def command(draw: Random) -> None:
    for name in ("plane.yaml", "complete.yaml", "zero-45.journal.jsonl"):
        shutil.copy(FIXTURES / name, name)
    for name, text in (("faces.csv", LOG), ("segments.csv", SEGMENTS), ("log.csv", LOG)):
        Path(name).write_text(text)
    start = draw.choice(sorted(STARTS))
    arguments = STARTS[start].split()
    for _ in range(draw.choice((1, 1, 2, 3))):
        names, valued = draw.choice(options_of(start))
        value = draw.choice((*WORDS, "1", "2.5", "plane.yaml", "log.csv", "x=1,y=2", "sca100t-d02", "g", "out.nc"))
        option = draw.choice(names)
        # Asking for a thousand million samples is no damage.
        value = (
            "3" if option in ENDLESS and option != "--address" else "sim:?" + value if option == "--address" else value
        )
        match draw.randrange(3):
            case 0:
                arguments = (
                    arguments[: draw.randrange(1, len(arguments) + 1)] + arguments[draw.randrange(len(arguments)) :]
                )
            case 1 if valued:
                arguments += [option, value]
            case _:
                arguments += [option]
    if "terminal" in arguments or not arguments:
        return
    arguments = [one.replace("\x00", "") for one in arguments]
    if arguments[0] in STARTS:
        run(*arguments)


# What a device says


class Babble:
    """A link that answers with anything: as many bytes as are asked for, most of them near to what is right."""

    def __init__(self, draw: Random, clock: object, letter: str, stream: bytes = b"") -> None:
        self.letter = letter
        self._draw, self._clock, self._stream, self._place = draw, clock, stream, 0

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self._clock.sleep(0.005)
        if self._stream:
            piece = self._stream[self._place : self._place + self._draw.choice((0, 1, 7, 60, 300))]
            self._place = (self._place + len(piece)) % len(self._stream)
            return piece if count else b""
        length = len(out) if self.letter == "s" else count
        return self._draw.choice((bytes(length), b"\xff" * length, self._draw.randbytes(length)))

    def close(self) -> None:
        pass


SENTENCES = (
    b"$PTCDC,%d,10375,10080,20740,20740,24.0*5C\r\n",
    b"0.12,-0.03,0.99,24.1\r\n",
    b"time=%d x=0.12 y=0.3\r\n",
    b"%d,10.5,0.1,0.2,0.3,0.4\r\n",
)


@target()
def device(draw: Random) -> None:
    """Every driver: bytes of a bus that mean nothing, and lines that are damaged."""
    from tiltcal.drivers import models
    from tiltcal.drivers.bus import link_letter
    from tiltcal.drivers.bus.address import parse_address
    from tiltcal.drivers.bus.clock import VirtualClock
    from tiltcal.drivers.device import SelfTesting

    model = draw.choice(list(models()))
    where = parse_address(draw.choice(model.addresses))
    model = model.at(where)
    clock, letter = VirtualClock(), link_letter(where, model)
    sentence = draw.choice(SENTENCES)
    lines = b"".join(sentence % number if b"%d" in sentence else sentence for number in range(60))
    stream = damaged_bytes(draw, lines) if letter in "r" else b""
    driver = model.driver(Babble(draw, clock, letter, stream), clock)
    for act in (driver.probe, driver.read, driver.read, driver.discard, driver.read):
        with suppress(TiltcalError):
            act()
    if isinstance(driver, SelfTesting):
        driver.self_test(model.channels[0])


# Formats that others parse


@cache
def parquet_log() -> bytes:
    import io

    import polars as pl

    stream = io.BytesIO()
    pl.read_csv(LOG.encode()).with_columns(note=pl.lit("é")).write_parquet(stream)
    return stream.getvalue()


@target(compiled=True)
def parquet(draw: Random) -> None:
    Path("log.parquet").write_bytes(damaged_bytes(draw, parquet_log()))
    run("apply", str(FIXTURES / "plane.yaml"), "log.parquet", "-o", draw.choice(("out.parquet", "out.csv")))


@cache
def netcdf_log() -> bytes:
    import polars as pl
    import xarray as xr

    data = pl.read_csv(LOG.encode())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.nc"
        variables = {name: ("time", data[name].to_numpy(), {"units": "count"}) for name in ("x", "y", "temperature")}
        xr.Dataset(variables, {"time": data["time"].to_numpy()}).to_netcdf(path, engine="h5netcdf")
        return path.read_bytes()


@target(compiled=True)
def netcdf(draw: Random) -> None:
    Path("log.nc").write_bytes(damaged_bytes(draw, netcdf_log()))
    run("apply", str(FIXTURES / "plane.yaml"), "log.nc", "-o", "out.nc")


VCD_HEADER = """\
$timescale 1 us $end
$scope module m $end
$var wire 1 ! D0 $end
$var wire 1 " D1 $end
$upscope $end
$enddefinitions $end
#0
0!
0"
"""
VCD = VCD_HEADER + "".join(
    f'#{1000 * k + 1}\n1!\n1"\n#{1000 * k + 480}\n0!\n#{1000 * k + 520}\n0"\n' for k in range(30)
)


@target()
def vcd(draw: Random) -> None:
    Path("c.vcd").write_bytes(damaged_table(draw, VCD))
    run("probe", "--sensor", "adxl202", "--address", "vcd:c.vcd?x=D0&y=D1")


# Many inputs, in processes that may end


@dataclass
class Figures:
    """How inputs ended, by target, and the ones that should not have ended so."""

    ends: dict[str, Counter[str]] = field(default_factory=dict)
    failures: list[tuple[str, int, str]] = field(default_factory=list)

    def add(self, name: str, number: int, end: str, detail: str = "") -> None:
        self.ends.setdefault(name, Counter())[end] += 1
        if end == FAILED:
            self.failures.append((name, number, detail))


def campaign(
    names: Sequence[str], seed: int, numbers: range, tell: Callable[[str], None] = lambda text: None
) -> Figures:
    """Try the numbers of each target one after the other, in a process that is started again when it ends."""
    figures = Figures()
    work = [(name, number) for number in numbers for name in names]
    done = 0
    while done < len(work):
        for (name, number), end, detail in _worked(seed, work[done : done + BATCH]):
            figures.add(name, number, end, detail)
            if end == FAILED:
                tell(f"{name} {number}: {detail}")
            done += 1
    return figures


def _worked(seed: int, work: Sequence[tuple[str, int]]) -> Iterator[tuple[tuple[str, int], str, str]]:
    """Let a worker try the inputs; ends early where one of them ended the worker."""
    with subprocess.Popen(
        [sys.executable, __file__, str(seed)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as worker:
        asked, told = worker.stdin, worker.stdout
        assert asked is not None
        assert told is not None
        for one in work:
            began = time.monotonic()
            with suppress(BrokenPipeError):
                asked.write(json.dumps(one).encode() + b"\n")
                asked.flush()
            ready, _, _ = select.select([told], [], [], 60 + SECONDS)
            line = told.readline() if ready else b""
            if line:
                end, detail = json.loads(line)
                yield one, end, detail
                if "memory" in detail:
                    break
                continue
            worker.kill()
            what = f"ended by signal {-worker.wait()}" if ready else f"no end after {time.monotonic() - began:.0f} s"
            yield one, ENDED if TARGETS[one[0]].compiled and ready else FAILED, what
            break
        with suppress(BrokenPipeError):
            asked.close()


def work(seed: int) -> None:
    """Be a worker: for each line with a target and a number tell how it ended."""
    for module in ("polars", "scipy.optimize", "scipy.signal", "matplotlib.figure", "xarray", "h5netcdf", "jinja2"):
        import_module(module)  # else the first input pays for it
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    most = 8 << 30
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    for line in sys.stdin:
        name, number = json.loads(line)
        end, detail = attempt(name, seed, number)
        used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        if used > MEGABYTES:
            end, detail = FAILED, f"{used:.0f} MB of memory"
        print(json.dumps((end, detail)), file=answers, flush=True)


if __name__ == "__main__":
    work(int(sys.argv[1]))
