"""The parts of a line: clocks in front, sums behind, labels, kinds of cells and fields, by the rule."""

import pytest

from tiltcal.column_guess import counts_up, guess, unit_of_rows
from tiltcal.dialect import Dialect, Pattern, flattened, kind_of, labels_of, printed, split, without_clock, without_sum
from tiltcal.logs.formats.csv_text import charset_of


def test_the_clock_of_a_monitor() -> None:
    for line, clock, rest in (
        ("12:03:11.123 -> 1,2", "12:03:11.123", "1,2"),
        ("[12:03:11,5] 1,2", "12:03:11,5", "1,2"),
        ("[2026-03-14 09:30:00.5] -> 1", "2026-03-14 09:30:00.5", "1"),
        ("9:30 > x", "9:30", "x"),
        ("9:30:01 PM -> x", "9:30:01 PM", "x"),
        ("12:03:11.123,1,2", "", "12:03:11.123,1,2"),
    ):
        assert without_clock(line) == (clock, rest)


def test_what_a_cell_holds() -> None:
    kinds = {
        "number": ("1", "-2.5", "+.5e-3", "1e5", " 7 ", "inf", "-Infinity"),
        "time": ("2026-03-14", "14.03.2026 09:30", "14/Mar/26", "09:30:01.5", "9:30 pm", "2026-03-14T09:30:00Z"),
        "missing": ("", " ", "NaN", "-nan", "N/A", "null", "None"),
        "text": ("a", "1,5", "1.5.2.7", "0x1F", "--1", "1 2", "1e"),
    }
    assert {kind: {kind_of(cell) for cell in cells} for kind, cells in kinds.items()} == {
        kind: {kind} for kind in kinds
    }
    assert [kind_of(cell, ",") for cell in ("1,5", "-,5e2", "1.5", "1,5,2")] == ["number", "number", "number", "text"]


def test_labels_and_numbers_of_a_line() -> None:
    """A label of a group holds up to the next one; three numbers behind a label are x, y and z; units are no labels."""
    for line, names, numbers in (
        ("X: 1.5 Y: -2 Z: 3e2", ["X", "Y", "Z"], ["1.5", "-2", "3e2"]),
        ("Gyro: X: 1 Y: 2 Acc: X: 3 Y: 4", ["Gyro X", "Gyro Y", "Acc X", "Acc Y"], ["1", "2", "3", "4"]),
        ("acc = 0.1, 0.2, 0.3 t = 5", ["acc x", "acc y", "acc z", "t"], ["0.1", "0.2", "0.3", "5"]),
        ("v: 1 2", ["v 1", "v 2"], ["1", "2"]),
        ("ax=0.5g ay=1g 2", ["ax", "ay 1", "ay 2"], ["0.5", "1", "2"]),
        ("1 2 3", ["x", "y", "z"], ["1", "2", "3"]),
        ("imu2 7.5 m/s^2", [""], ["7.5"]),
    ):
        texts, found = printed(line)
        assert (labels_of(texts), found) == (names, numbers), line
        assert "".join(text + number for text, number in zip(texts, [*found, ""], strict=True)) == line


def test_fields_sums_patterns_and_objects() -> None:
    assert split('1 ,"a,b",3', ",") == ["1", "a,b", "3"]
    assert split('1,"a,3', ",") == ["1", '"a', "3"]
    assert split(" 1  2 ", " ") == ["1", "2"]
    assert (without_sum("$A,1*70"), without_sum("$A,1*71"), without_sum("A,1*70")) == ("", "", "")
    assert without_sum("$A,1*5C") == "$A,1"  # 0x41 ^ 0x2C ^ 0x31
    assert flattened({"a": {"b": [1, 2, 3], "c": [4]}, "d": None, "e": "f", "g": True}) == {
        "a.b.x": "1", "a.b.y": "2", "a.b.z": "3", "a.c.0": "4", "d": "", "e": "f", "g": "true"
    }  # fmt: skip
    with pytest.raises(ValueError, match="no object"):
        flattened(5)
    rows = Pattern(("x = ", " y = ", " mg"))
    assert rows.cells("X =1.5 y= nan mg") == ["1.5", "nan"]
    assert rows.cells("x = 1.5 y = 2") is rows.cells("x = a y = 2 mg") is None
    assert rows.at_once(b"x = 1 y = 2 mg\nx = 3 y = 4 mg\n", b";") == b"1;2\n3;4\n"
    for damaged in (b"x = 1 y = 2 mg\ny = 4 mg\n", b"x = 1 y = 2 mg7\n", b"\x011 y = 2 mg\n"):
        assert rows.at_once(damaged, b";") is None
    assert Pattern(("", " y = ", "")).at_once(b"1 y = 2\n3 y = 4\n", b";") == b"1;2\n3;4\n"
    assert Pattern(("x = ", " y = ", "")).at_once(b"x = 1 y = 2\nx = 3 y = 4\n", b",") == b"1,2\n3,4\n"
    assert Pattern(("", " g ", " g")).at_once(b"1 g 2 g\n", b";") == b"1;2\n"
    objects = Pattern((), ("a", "b"))
    assert objects.cells('{"b": 2, "a": 1}') == ["1", "2"]
    assert objects.cells('{"b": 2}') == ["", "2"]
    assert objects.cells('{"c": 2}') is objects.cells("{") is None
    stated = Dialect(("time", "a", "b"), has_clock=True, decimal=",", separator=";", head=("a;b", "12:00:00 -> 1;2"))
    assert stated.fields_of("12:00:01,5 -> 1;2,5") == "12:00:01.5;1;2,5"
    assert stated.fields_of("1;2") == '"1;2"'
    sentences = Dialect(("kind", "a"), has_sum=True)
    assert [sentences.fields_of(line) for line in ("$A,1*5C", "$A,1*5D")] == ["$A,1", '"$A,1*5D"']
    lines = ("12:00:01 -> ", "12:00:01 -> # x", "12:00:01 -> a;b", "12:00:01 -> 1;2")
    assert [stated.no_row(line) for line in lines] == ["empty", "comment", "header", ""]


def test_the_encoding_of_text_without_a_mark() -> None:
    """One byte that is damaged among several characters of UTF-8, and none among one."""
    for data, encoding in (
        (b"x,y\n1,2\n", "utf-8"),
        ("°,µ,²".encode() + b"\xb0", "utf-8"),
        ("°".encode() + b"\xb0", "cp1252"),
        (b"20 \xb0C", "cp1252"),
    ):
        assert charset_of(data) == encoding, data


def test_the_meaning_of_columns_by_names_lengths_and_numbers() -> None:
    """Units that differ say nothing; three columns as long as gravity, or as a power of two of counts, are the axes."""
    rows = ["0.1,0.2,9.8", "0.1,0.3,9.7", "0.2,0.1,9.8"]
    for lines, roles, unit, per_g, by in (
        (["ax (g),ay (g),az (g)", *rows], ("x", "y", "z"), "g", 0.0, "names"),
        (["ax (g),ay (m/s2),az (g)", *rows], ("x", "y", "z"), "m/s2", 0.0, "names"),
        (["7," + row for row in rows], ("-", "x", "y", "z"), "m/s2", 0.0, "length"),
        (["1,20,4090", "3,20,4100", "2,10,4095"], ("x", "y", "z"), "count", 4096.0, "length"),
        (["1,20,3000", "3,20,3010", "2,10,3001"], ("x", "y", "z"), "", 0.0, "number"),
        (["1,2,3,4", "2,1,2,3", "1,2,2,3"], ("-", "-", "-", "-"), "", 0.0, "number"),
        ([f"{k},0.{k % 2},0.2,9.8" for k in range(7)], ("-", "x", "y", "z"), "m/s2", 0.0, "length"),
        ([f"{k},3{k % 2},-20,240" for k in range(7)], ("-", "x", "y", "z"), "count", 256.0, "length"),
    ):
        found = guess(lines)
        assert (found.roles, found.unit, found.per_g, found.by, found.example) == (roles, unit, per_g, by, lines[-1])
    for lines in ([], ["hello"], ["a,b", "c,d"]):
        assert guess(lines) == ((), "", 0.0, "", "")
    for unit, low, high in (("g", 0.9, 1.1), ("m/s2", 9.3, 10.3), ("mg", 930.0, 1070.0), ("mm/s2", 9300.0, 10300.0)):
        for length, said in ((0.9999 * low, ""), (1.0001 * low, unit), (0.9999 * high, unit), (1.0001 * high, "")):
            assert unit_of_rows([[0.6 * length], [0.8 * length], [1e-9]]) == said
    for column, counts in (
        ([0, 1, 2, 3, 4, 5], False),
        ([0, 1, 2, 3, 4, 5, 6], True),
        ([0, 1, 2, 3, 4, 24], False),
        ([0, 1, 2, 3, 4, 23], True),
        ([0, 1, 2, 3, 4, 3, 9], False),
        ([2, 2, 2, 2], False),
        ([5], False),
    ):
        assert counts_up(column) is counts, column
