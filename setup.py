"""Give the index the README with absolute links; everything else of the package stands in pyproject.toml."""

import re
import tomllib
from pathlib import Path

from setuptools import setup

HERE = Path(__file__).parent
SOURCE = tomllib.loads((HERE / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Source"]
LINK = re.compile(r"(!?)(\[[^]]*\]\()(?!https?:|#)")

setup(
    long_description=LINK.sub(
        lambda link: f"{link[1]}{link[2]}{SOURCE}/{'raw' if link[1] else 'blob'}/main/",
        (HERE / "README.md").read_text(encoding="utf-8"),
    ),
    long_description_content_type="text/markdown",
)
