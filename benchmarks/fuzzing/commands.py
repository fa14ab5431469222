"""Commands with damaged input: files that are checked and used, and arguments."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from random import Random

from support import FIXTURES
from support.command import tiltcal

from fuzzing.damage import WORDS, damaged_bytes, damaged_journal, damaged_table, damaged_yaml
from fuzzing.inputs import CALIBRATIONS, JOURNALS, LOG, SEGMENTS, golden, netcdf_log, parquet_log, shipped, target
from tiltcal.errors import TiltcalError


def run(*arguments: str) -> int:
    """Call the command line; an error of ours is raised as one, another exit code than the documented ones fails."""
    done = tiltcal(*arguments)
    if done.returncode in (2, 3, 130):  # 130 where the input of a person ends
        if not re.search(r"^(tiltcal: |Error: |Usage: )", done.stderr, re.MULTILINE):
            raise AssertionError(f"exit code {done.returncode} without a reason: {done.stderr!r}")
        raise TiltcalError(done.stderr)
    if done.returncode not in (0, 1):
        raise AssertionError(f"exit code {done.returncode}: {done.stderr}")
    return done.returncode


@target()
def calibration_used(draw: Random) -> None:
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
def procedure_used(draw: Random) -> None:
    Path("p.yaml").write_bytes(damaged_yaml(draw, draw.choice([*shipped("procedures").values()])))
    run("check", "p.yaml")
    run(*draw.choice((("procedures", "./p.yaml"), ("plan", "./p.yaml", "--sensor", "sca100t-d02", "--jig", "0.1"))))


@target()
def twin_used(draw: Random) -> None:
    text = draw.choice([*shipped("fixtures/twins").values()])
    model = re.search(r"^model: (\S+)", text, re.MULTILINE)
    Path("t.yaml").write_bytes(damaged_yaml(draw, text))
    run("check", "t.yaml")
    sensor = model[1] if model else "sca3000-d01"
    run("record", "--sensor", sensor, "--address", "sim:twin=t.yaml", "--rows", "3", "-o", "l.csv")


# Journals


@target()
def journal_used(draw: Random) -> None:
    name = draw.choice(JOURNALS)
    Path("j.journal.jsonl").write_bytes(damaged_journal(draw, (FIXTURES / f"{name}.journal.jsonl").read_bytes()))
    run("check", "j.journal.jsonl")
    if draw.random() < 0.7:
        run("replay", "j.journal.jsonl", "-o", "again.yaml")
    else:
        run("measure", "--resume", "j.journal.jsonl", "--operator", "sim")


# Tables and texts


@target()
def csv_used(draw: Random) -> None:
    damaged = draw.randrange(2)
    Path("log.csv").write_bytes(LOG.encode() if damaged else damaged_table(draw, LOG))
    Path("s.csv").write_bytes(damaged_table(draw, SEGMENTS) if damaged else SEGMENTS.encode())
    plane = str(FIXTURES / "plane.yaml")
    run(
        *draw.choice(
            (
                ("apply", plane, "log.csv", "-o", "out.csv"),
                ("apply", plane, "log.csv", "-o", "out.csv", "--skip-bad-rows"),
                ("apply", plane, "log.csv", "-o", "out.parquet", "--uncertainty"),
                ("fit", "six-face", "log.csv", "--segments", "s.csv", "--unit", "g", "--serial", "S", "-o", "s.yaml"),
                ("fit", "free", "log.csv", "--unit", "g", "--serial", "S", "-o", "s.yaml"),
                ("noise", "log.csv", "--rate", "10", "--unit", "g"),
                ("match", "log.csv", "--pair", "x,y", "--orthogonal", "z", "--phase", "theta", "-o", "p.yaml"),
                ("report", plane, "log.csv", "-o", "r.html"),
            )
        )
    )


# Commands


@cache
def options_of(command: str) -> Sequence[tuple[list[str], bool]]:
    """Return the names of a command's options, and whether each takes a value."""
    from tiltcal.cli.main import group

    parameters = group.get_command(group.make_context("tiltcal", [command]), command).params
    return [
        (list(one.opts), not getattr(one, "is_flag", False)) for one in parameters if one.param_type_name == "option"
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
ENDLESS = {"--samples", "--rows", "--for", "--settle", "--rate", "--turns", "--target", "--scheduler", "--workers"}
"""Options whose damaged values would be no damage, but a thousand million samples."""


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
        value = "3" if option in ENDLESS else "sim:?" + value if option == "--address" else value
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


# Formats that others parse


@target(compiled=True)
def parquet_used(draw: Random) -> None:
    Path("log.parquet").write_bytes(damaged_bytes(draw, parquet_log()))
    run("apply", str(FIXTURES / "plane.yaml"), "log.parquet", "-o", draw.choice(("out.parquet", "out.csv")))


@target(compiled=True)
def netcdf_used(draw: Random) -> None:
    Path("log.nc").write_bytes(damaged_bytes(draw, netcdf_log()))
    run("apply", str(FIXTURES / "plane.yaml"), "log.nc", "-o", "out.nc")
