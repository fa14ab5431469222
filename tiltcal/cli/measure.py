"""``tiltcal measure``: calibrate sensors at the bench."""

from __future__ import annotations

from typing import Any

import click

from tiltcal.bench.options import MeasureOptions
from tiltcal.cli import options
from tiltcal.cli.config import defaults_here
from tiltcal.cli.talk import remark


@options.command(
    epilog="Example: tiltcal measure zero-45 --sensor sca100t-d02 --address spi:///dev/spidev0.0 --serial S-0042 "
    "-o S-0042.yaml"
)
@click.argument("procedure", required=False)
@options.declared(MeasureOptions)
def command(procedure: str | None, **settings: Any) -> None:
    """Measure the positions of PROCEDURE, write the calibration file, and print its coefficients.

    PROCEDURE is one of `tiltcal procedures`, or the path of your own. With `rotation` a stage turns instead, and -o is
    the file of its pairs. A journal records everything at once: after a crash, a power cut or Ctrl-C, `--resume
    JOURNAL` continues from the last byte.
    """
    from tiltcal.library.measure import measure

    measure(procedure, remark=remark, result=click.echo, defaults=defaults_here, **settings)
