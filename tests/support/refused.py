"""What is wrong in files of each kind, from ``refused.yaml`` beside this file, and how a reader has to say it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from tiltcal.errors import InputError

TABLE = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))


def require_refused(kind: str, text: str, read: Callable[[str], Any]) -> None:
    """Make each change of a sound text, and compare line, key and words of the refusal."""
    read(text)
    for words, changes in TABLE[kind].items():
        for old, new, line, key in changes:
            assert old in text
            with pytest.raises(InputError) as caught:
                read(text.replace(old, new, 1))
            begun, rest, _ = words.partition(", ...")
            said = caught.value.message[: len(begun) if rest else None]
            assert (caught.value.line, caught.value.key, said) == (line, key, begun), new
