"""A file of ours is YAML 1.2, and whatever is wrong in it is told with file, line and key."""

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec import Meta

from tiltcal.errors import InputError
from tiltcal.files import yaml_text as yaml_module
from tiltcal.files.calibration import tilt_record
from tiltcal.files.document import document_of, parse_document, read_document
from tiltcal.files.record import AboveZero, ByAxis, Finite, FromZero, Record, Text
from tiltcal.files.yaml_text import NODE_LIMIT, yaml_text
from tiltcal.stated_arguments import CONTROL


def complaint(text: str, reading: Any = None) -> InputError:
    """The error that reading a document raises."""

    def read() -> None:
        node = parse_document(text, "f.yaml")
        if reading is not None:
            reading(node)

    with pytest.raises(InputError) as caught:
        read()
    return caught.value


class Part(Record):
    model: str
    address: str | None = None


class Values(Record, kw_only=True):
    """One key of each type."""

    number: Finite | None = None
    least: FromZero | None = None
    above: AboveZero | None = None
    whole: Annotated[int, Meta(ge=2)] | None = None
    text: Text | None = None
    flag: bool | None = None
    list: tuple[Finite, ...] = ()
    by_axis: ByAxis[Finite] = {}  # noqa: RUF012
    free: Mapping[str, Finite] = {}
    sensor: Part | None = None
    parts: tuple[Part, ...] = ()


def value(key: str, written: str) -> Any:
    return getattr(parse_document(f"{key}: {written}", "f.yaml").read(Values), key)


def told(text: str) -> InputError:
    return complaint(text, lambda document: document.read(Values))


def as_text(data: Any) -> Any:
    """Return plain data as a document has them: scalars are text."""
    if isinstance(data, dict):
        return {name: as_text(value) for name, value in data.items()}
    if isinstance(data, list):
        return [as_text(value) for value in data]
    return {True: "true", False: "false"}[data] if isinstance(data, bool) else None if data is None else str(data)


def alike(read: Any, written: Any) -> bool:
    """Return whether the texts of a document are those that were written; numbers count by their values."""
    if isinstance(written, dict):
        return read.keys() == written.keys() and all(alike(read[name], written[name]) for name in written)
    if isinstance(written, list):
        return len(read) == len(written) and all(map(alike, read, written))
    if isinstance(written, float):
        return float(read) == written
    return bool(read == as_text(written))


# What PyYAML alone gets wrong in silence (SPEC 9).


def test_what_each_type_takes() -> None:
    for key, written, meant in (
        *(("number", "1e-8", 1e-8), ("number", "0042", 42.0), ("number", "-.5", -0.5), ("number", "+12.", 12.0)),
        *(("number", "1E3", 1e3), ("number", "0x1d", 29.0), ("number", "0o17", 15.0), ("number", '"1.5"', 1.5)),
        *(("text", one, one) for one in ("0042", "1e3", "yes", "no", "on", "y", "2026-01-02", "12:30")),
        *(
            ("text", '"null"', "null"),
            ("flag", "true", True),
            ("flag", "False", False),
            ("list", "[1, 1e-8]", (1.0, 1e-8)),
        ),
    ):
        assert value(key, written) == meant, written


def test_what_a_type_does_not_take_is_shown() -> None:
    words = ("12:30", "1_000", "yes", "1,5", "0b11", "[1]", "{a: 1}", "+0x1d", "१", "nan", "inf", "-.Inf", ".NaN")
    large = ("1e999", "-1e999", "9" * 500, "0x" + "f" * 300)
    for written, about in (
        *((f"number: {one}", "a number is needed here, found") for one in words),
        *((f"number: {one}", "too large a number") for one in large),
        ("number: 1,5", "write the point as '.'"),
        ("number: 1.5 V", "write the number alone"),
        ("number: .nan", "it must be finite"),
        *((f"text: {one}", "text") for one in ('""', '"  "', "[a]")),
        *(
            (f"sensor: {{model: {one}}}", "sensor.model: text is needed here, found nothing")
            for one in ("", "~", "null")
        ),
        ("flag: yes", "true or false is needed here"),
        ("least: -0.1", "at least 0"),
        ("least: 1e10", "at most 1000000000"),
        ("above: 0", "more than 0"),
        ("above: 1e-10", "at least 1e-09"),
        ("above: 1e300", "at most 1000000000"),
        ("whole: 1", "at least 2"),
        ("whole: 1.5", "a whole number"),
        ("whole: one", "a whole number"),
    ):
        error = told(written)
        assert (error.file, error.line) == ("f.yaml", 1)
        assert about in str(error), written


# Places.


def test_the_place_is_found_wherever_it_is() -> None:
    for text, line, key, about in (
        ("sensor:\n  model: a\n  adress: b\n", 3, "sensor.adress", "unknown key 'adress' (did you mean 'address'?)"),
        ("number: 1\nsensor:\n  address: a\n", 2, "sensor", "'model' is missing"),
        ("parts:\n- {model: a}\n-\n  model: [x]\n", 4, "parts[1].model", "found a list"),
        ("free:\n  a: 1\n  b c: x\n", 3, "free.b c", "found 'x'"),
        ("by_axis:\n  x: 1\n  w: 1\n", 3, "by_axis.w", "unknown key"),
        ("list:\n- 1\n- x\n", 3, "list[1]", "found 'x'"),
        ("free:\n  x: 1\n  y: 2\n  x: 3\n", 4, "free.x", "lines 2 and 4"),
    ):
        error = told(text)
        assert (error.line, error.key) == (line, key)
        assert about in error.message


def test_optional_key_that_holds_nothing_is_absent() -> None:
    assert parse_document("number: 1\nlist:\nby_axis: {x: }\n").read(Values) == Values(number=1.0)


# What is refused.


def test_what_no_file_of_ours_needs_is_refused_with_its_line() -> None:
    for text, line, about in (
        ("a: &x [1]\nb: *x\n", 1, "anchor"),
        ("a: 1\nb: *x\n", 2, "alias"),
        ("a: !!python/object/apply:os.system ['true']\n", 1, "tag"),
        ("a: ! 1\n", 1, "tag"),
        ("a: 1\n---\nb: 2\n", 2, "second document"),
        ("? [a, b]\n: 1\n", 1, "keys are text"),
        ("a:\n\t- 1\n", 2, "not YAML"),
        ("a: [1,\nb: 2]]", 2, "not YAML"),
        ("a: 1\nb: \x07\n", 2, "not YAML"),
        ("", None, "empty"),
        ("# nothing\n", None, "empty"),
    ):
        error = complaint(text)
        assert error.line == line, text
        assert about in str(error)


def test_depth_has_an_end() -> None:
    parse_document("[" * 32 + "]" * 32)
    assert "deeper" in str(complaint("[" * 33 + "]" * 33))
    assert "deeper" in str(complaint("- " * 100_000))


def test_number_of_values_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The list counts as one of them."""
    assert NODE_LIMIT == 200_000
    monkeypatch.setattr("tiltcal.files.yaml_text.NODE_LIMIT", 2000)
    assert len(parse_document("[" + "1," * 1999 + "]", "f.yaml").items()) == 1999
    assert "more than 2,000 values in one file" in str(complaint("[" + "1," * 2000 + "]"))


def test_large_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    path.touch()
    os.truncate(path, 1 << 30)
    for place, said in (
        (path, "the file is too large: at most 4,000,000 bytes are read"),
        (tmp_path, "this is a folder; name a file in it"),
        (tmp_path / "absent.yaml", "no such file"),
    ):
        with pytest.raises(InputError) as refused:
            read_document(place)
        assert str(refused.value) == f"{place}: {said}"


def test_a_byte_order_mark_is_no_part_of_the_first_key_and_what_is_not_utf8_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "f.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert read_document(path).data == {"a": "1"}
    path.write_bytes("a: 1\nb: 20 °C\n".encode("latin-1"))
    with pytest.raises(InputError, match=r"f.yaml:2: not UTF-8 \(byte 0xb0\)"):
        read_document(path)


# Which file it is.


def test_version_and_kind_are_checked_first(tmp_path: Path) -> None:
    path = tmp_path / "f.yaml"
    for text, line, about in (
        ("kind: tilt\n", 1, "'tiltcal' is missing"),
        ("tiltcal: 1\n", 1, "'kind' is missing"),
        ("kind: tilt\ntiltcal: 2\n", 2, "version 2"),
        ("tiltcal: 1\nkind: pair\n", 2, "a pair calibration"),
        ("tiltcal: 1\nkind: tlit\n", 2, "did you mean 'tilt'"),
        ("- tiltcal: 1\n", 1, "a mapping is needed"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=about) as caught:
            tilt_record(read_document(path))
        assert caught.value.line == line


# Properties.

scalars = st.none() | st.booleans() | st.integers(-(10**18), 10**18) | st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=40)
numbers = ["1e-8", "0042", "12:30", "2026-01-02", ".5", ".inf", "0x1d", "1_000"]
words = ["yes", "No", "on", "null", "~", "=", "<<", "y", "N", "#", "&a", "*a", "!a", "|", ">", "%a", "@a", "`a"]
tricky = st.sampled_from([*numbers, *words, "- a", "a: b", "a #b", " a", "a ", "", "a\nb", "\t", "\u2028"])
keys = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=20) | tricky.filter(
    lambda key: not CONTROL.search(key)
)
data = st.recursive(
    scalars | texts | tricky,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(keys, inner, max_size=5),
    max_leaves=30,
)
documents = st.dictionaries(keys, data, max_size=5)


@given(documents)
@example({"words": ["yes", "12:30", "0042", "1e-8", "~", "y"], "tiny": 1e-8, "huge": 1e22, "minus": -0.0})
@example({"prompt": "Tilt it: " + "slowly and then again, " * 20, "values": [0.125 * n for n in range(60)]})
@example({"a": [{"b": [{"c": [[], {}, [[1]]]}]}]})
@example({"tiny": 1e-8, "serial": "0042", "time": "12:30", "words": ["yes", "off", "null", "1_000", "2026-01-02"]})
def test_what_is_written_reads_back_equal_under_yaml_1_1_too(written: dict[str, Any]) -> None:
    assert alike(parse_document(yaml_text(written)).data, written)
    assert yaml.safe_load(yaml_text(written)) == written


def test_letters_that_the_specification_of_yaml_1_1_lists_as_truth_values_are_quoted() -> None:
    """https://yaml.org/type/bool.html; R's yaml and Go's yaml.v2 follow it, PyYAML leaves the letters out."""
    assert yaml_text({"y": ["x", "y", "N"], "n": 1}) == '"y": [x, "y", "N"]\n"n": 1\n'


def test_plain_data_may_be_as_deep_as_a_file_and_no_deeper() -> None:
    deep: Any = 1
    for _ in range(32):
        deep = [deep]
    assert document_of(deep).data == deep
    for around in ([deep], {"in": deep}):
        with pytest.raises(InputError, match="nested deeper than 32"):
            document_of(around)


@given(st.binary(max_size=200) | st.text("ab:-[]{}?&*!|>'\"%@#, \n\t0.~", max_size=60).map(str.encode))
def test_bytes_of_any_kind_are_read_or_refused_and_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, raw: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(raw)
    with suppress(InputError):
        read_document(path)


@given(st.text("ab:-[]{}?'\"#, \n0.~", max_size=40))
def test_the_parser_in_python_agrees_with_the_one_in_c(text: str) -> None:
    def outcome() -> Any:
        try:
            return parse_document(text).data
        except InputError:
            return InputError

    fast = outcome()
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr(yaml_module.yaml, "CBaseLoader", raising=False)
        slow = outcome()
    assert fast == slow or InputError in (fast, slow)


def test_what_cannot_be_read_back_is_not_written() -> None:
    for value in (math.nan, math.inf, -math.inf, "\ud800", object(), b"bytes"):
        with pytest.raises(InputError) as caught:
            yaml_text({"fit": {"chi": [value]}})
        assert caught.value.key == "fit.chi[0]"
    for name in (1, None, "k" * 101, "\x1b[2J"):
        with pytest.raises(InputError, match=r"a key is a text|the control character"):
            yaml_text({"fit": {name: 1}})


def test_control_characters_are_no_text_and_no_key() -> None:
    """A terminal takes them for commands: ESC ] 0 ; sets its title, CSI 2 J clears it."""
    for character in ("\\x1b", "\\x07", "\\r", "\\x9b", "\\x7f"):
        for text, place in (
            (f'kind: x\nserial: "S{character}[2J"\n', r"a.yaml:2: serial: the control character"),
            (f'"S{character}[2J": 1\n', r"a.yaml:1: the control character"),
        ):
            with pytest.raises(InputError, match=place) as caught:
                parse_document(text, "a.yaml")
            assert str(caught.value).isprintable()
    with pytest.raises(InputError, match="control"):
        document_of([{"a\x1b[2J": 1}])
    # What a text device is sent may hold them, in its file and in the key ``device``, and nowhere else.
    for text in ('ask: "\\x02R"', 'ends: "\\x02"', 'a: [{device: {answer: "\\x02"}}]'):
        parse_document(text)
    for text, key in (
        ('a: {ask: "\\x02"}', "a.ask"),
        ('device: "\\x02"', "device"),
        ('device: {a: "\\x02"}', "device.a"),
    ):
        assert complaint(text).key == key
