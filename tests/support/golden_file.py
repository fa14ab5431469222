"""What a golden file holds, read by another reader than ours."""

from typing import Any

import yaml

from support import FIXTURES


def as_data(name: str) -> dict[str, Any]:
    """The whole content."""
    data: dict[str, Any] = yaml.safe_load((FIXTURES / f"{name}.yaml").read_text(encoding="utf-8"))
    return data


def coefficients(data: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Name, value and uncertainty of all that the section ``calibration`` holds, but the mounting."""
    section, u = data["calibration"], data["uncertainty"]
    found = [(f"offset.{c}", v, u["offset"][c]) for c, v in section["offset"].items()]
    for c, row in section["sensitivity"].items():
        found += [(f"sensitivity.{c}.{axis}", v, u["sensitivity"][c][axis]) for axis, v in row.items()]
    for what in ("offset", "sensitivity"):
        for c, row in section.get("temperature", {}).get(what, {}).items():
            doubts = u["temperature"].get(what, {}).get(c, [0.0] * len(row))
            found += [(f"temperature.{what}.{c}.{k + 1}", v, doubts[k]) for k, v in enumerate(row)]
    for c, row in section.get("nonlinearity", {}).items():
        found += [(f"nonlinearity.{c}.{k}", v, u["nonlinearity"][c][k - 2]) for k, v in enumerate(row, start=2)]
    return found
