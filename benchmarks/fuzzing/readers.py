"""Readers and drivers with damaged input, called as functions: thousands of inputs in a minute."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from itertools import islice
from pathlib import Path
from random import Random
from time import process_time

from fuzzing.damage import damaged_bytes, damaged_journal, damaged_json, damaged_table, damaged_text, damaged_yaml
from fuzzing.inputs import BENCH, CALIBRATIONS, JOURNALS, VCD, golden, shipped, target
from tiltcal.drivers import models
from tiltcal.drivers.model import Model
from tiltcal.errors import TiltcalError

EVENTS = 25
"""Lines of a journal that are read, beside its first and its last."""

ROWS = 40
"""Rows of a log that are read."""


@cache
def known_models() -> Sequence[Model]:
    """Return all sensor models."""
    return list(models())


# Files in YAML, and journals


@target(share=30)
def calibration(draw: Random) -> None:
    from tiltcal.files.calibration import read_calibration

    Path("c.yaml").write_bytes(damaged_yaml(draw, golden(f"{draw.choice(CALIBRATIONS)}.yaml")))
    _ = read_calibration("c.yaml").text


@target(share=40)
def pair(draw: Random) -> None:

    from tiltcal.files.document import read_document
    from tiltcal.files.pair import pair_record

    Path("p.yaml").write_bytes(damaged_yaml(draw, golden("rotation.yaml")))
    _ = pair_record(read_document("p.yaml")).text


@target(share=80)
def procedure(draw: Random) -> None:
    from tiltcal.files.procedure import read_procedure

    Path("p.yaml").write_bytes(damaged_yaml(draw, draw.choice([*shipped("procedures").values()])))
    read_procedure("p.yaml")


@target(share=80)
def bench(draw: Random) -> None:
    from tiltcal.bench.setup import known_bench
    from tiltcal.files.document import read_document

    Path("b.yaml").write_bytes(damaged_yaml(draw, BENCH))
    known_bench(read_document("b.yaml"))


@target(share=80)
def twin(draw: Random) -> None:
    from tiltcal.files.twin import read_twin

    Path("t.yaml").write_bytes(damaged_yaml(draw, draw.choice([*shipped("fixtures/twins").values()])))
    read_twin("t.yaml", 1)


@target(share=60)
def journal(draw: Random) -> None:
    from tiltcal.journal.header import Setup
    from tiltcal.journal.lines import Journal

    lines = golden(f"{draw.choice(JOURNALS)}.journal.jsonl").encode().splitlines(keepends=True)
    first = draw.randrange(1, max(len(lines) - EVENTS, 2))
    piece = b"".join((lines[0], *lines[first : first + EVENTS], lines[-1]))
    Path("j.jsonl").write_bytes(damaged_journal(draw, piece))
    found = Journal("j.jsonl")
    Setup.of(found)
    for _ in found:
        pass


@target(share=100)
def address(draw: Random) -> None:
    from tiltcal.drivers.bus.address import parse_address

    model = draw.choice(known_models())
    text = draw.choice((*model.addresses, "sim:seed=1", "sim:twin=t.yaml&seed=2"))
    damaged = damaged_bytes(draw, text.encode()).decode(errors="replace")
    model.at(parse_address(damaged_text(draw, text) if draw.random() < 0.8 else damaged))


@target(share=100)
def answer(draw: Random) -> None:
    from tiltcal.bench.operators import parsed, understood

    text = '{"answer": "ready", "tilt": {"x": 30.0}, "gravity": [0, 0.5, 0.866], "temperature": 20.5}'
    way = draw.choice((damaged_bytes, lambda draw, data: damaged_text(draw, data.decode()).encode(errors="replace")))
    for line in (way(draw, text.encode()), damaged_json(draw, text)):
        with suppress(TiltcalError):
            understood(parsed(line.decode(errors="replace")))


@target(share=100)
def head(draw: Random) -> None:
    """The first lines of a log of any kind: what is read are the numbers that csv and float read, within 2 s."""
    from support.kinds_of_logs import ENCODINGS, KINDS, rows

    from tiltcal.dialect import kind_of
    from tiltcal.logs.formats import open_log

    name = draw.choice(list(KINDS))
    before, row = KINDS[name]
    some = islice(rows(), draw.choice((0, 1, 3, ROWS)))
    text = before + "".join(f"{row(one)}\n" for one in some)
    if draw.random() < 0.5:
        Path("log.txt").write_bytes(damaged_bytes(draw, text.encode(ENCODINGS.get(name, "utf-8"))))
    else:
        Path("log.txt").write_bytes(damaged_table(draw, text))
    began = process_time()
    with open_log("log.txt", skip_bad_rows=True) as log:
        found = list(log.rows(range(len(log.names))))
        if log.text.encoding == "UTF-8":
            lines = Path("log.txt").read_bytes().decode(errors="replace").removeprefix("\ufeff").split("\n")
            dialect, cells = log.dialect, []
            for line in lines[log.dialect.first :]:
                line = line.removesuffix("\r")
                if line and not dialect.no_row(line):
                    with suppress(csv.Error):
                        cells.append(next(csv.reader([dialect.fields_of(line)], delimiter=dialect.separator), []))
                        continue
                    cells.append([])
            values = [[value for block in found for value in block.values[k].tolist()] for k in range(len(log.names))]
            for number, texts in enumerate(cells):
                for column, text in zip(values, texts, strict=False):
                    text = dialect.with_point(text.strip(" \t"))
                    if column[number] == column[number] and kind_of(text) == "number" and float(text) != column[number]:
                        raise AssertionError(f"row {number}: {text!r} was read as {column[number]}")
    if process_time() - began > 2.0:
        raise AssertionError(f"it took {process_time() - began:.1f} s")


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


@target(share=100)
def device(draw: Random) -> None:
    """Every driver: bytes of a bus that mean nothing, and lines that are damaged."""
    from tiltcal.drivers.bus import link_letter
    from tiltcal.drivers.bus.address import parse_address
    from tiltcal.drivers.bus.clock import VirtualClock

    model = draw.choice(known_models())
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
    for channel in model.channels[:1]:
        driver.self_test(channel)


@target(share=40)
def vcd(draw: Random) -> None:
    from tiltcal.drivers.bus.vcd import VcdLink

    Path("c.vcd").write_bytes(damaged_table(draw, VCD))
    link = VcdLink("c.vcd", "D0", "D1")
    try:
        for _ in range(5):
            link.exchange(b"", 100)
    finally:
        link.close()
