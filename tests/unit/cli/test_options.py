"""What the commands print for programs."""

from __future__ import annotations

import json
from math import inf, nan

from tiltcal.cli.options import json_text


def test_json_has_no_number_that_is_not_finite() -> None:
    text = json_text({"p": nan, "limits": (inf, -inf, 1.5), "rows": [{"n": 3, "°C": None}]})
    assert text.isascii()
    assert json.loads(text) == {"p": None, "limits": [None, None, 1.5], "rows": [{"n": 3, "°C": None}]}
