"""``python -m tiltcal`` is the ``tiltcal`` command."""

from tiltcal.cli.main import main

main()
