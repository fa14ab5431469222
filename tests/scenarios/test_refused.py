"""Settings that do not go together are refused before anyone starts, with the reason."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support import FIXTURES
from support.command import tiltcal

from tiltcal.files.procedure import find_procedure

ON_SIM = "--operator sim --address sim: --serial S-1 -o x.yaml"
SCA100T = f"--sensor sca100t-d02 {ON_SIM}"
STAGE = f"--sensor gradiometer {ON_SIM}"

REFUSED = {
    f"measure rotation {STAGE.replace('sim:', 'sim:columns=a1,a2')}": "no device has the stage angle 'theta' (there",
    f"measure rotation {STAGE.replace('sim:', 'sim:columns=theta,a1,a2')}": "not matched: there is no a4; a3 and a4",
    f"measure plane --sensor serial-columns {ON_SIM.replace('sim:', 'sim:columns=x,up')}": "the virtual device has x",
    f"measure plane --sensor sca100t-d01 {ON_SIM.replace('sim:', f'sim:twin={FIXTURES}/twins/sca100t-d02.yaml')}": (
        "the twin file is of a sca100t-d02, not of a sca100t-d01"
    ),
    f"measure plane {STAGE}": "reads theta, a1, a2, a3, a4 there",
    "plan plane --sensor gradiometer": "takes tilt sensors, which read x, y and z",
    "fit plane log.csv --segments s.csv --sensor gradiometer --serial G -o g.yaml": "takes tilt sensors",
    "fit rotation log.csv --serial G --unit g -o g.yaml": "with `tiltcal match`",
    f"verify {FIXTURES}/plane.yaml --procedure rotation --address sim:": "`tiltcal match`",
    f"measure two-temperature --sensor serial-columns {ON_SIM.replace('sim:', 'sim:unit=V&columns=x,y')}": (
        "state it in the address (sensitivity="
    ),
    f"measure plane {SCA100T} --turns 3": "leave --turns out",
    f"measure rotation {STAGE} --turns 1": "from 2",
    f"measure rotation {STAGE} --samples 9": "leave --samples",
    f"measure rotation {STAGE} --tilt 9": "no angle free",
    f"measure rotation {STAGE} --typical-temperature": "needs no --typical-temperature",
    f"measure free {SCA100T}": "free positions need a sensor of three channels x, y and z, and sca100t-d02 has x, y",
    f"measure free --sensor sca3000-d01 {ON_SIM} --jig 0.3": "use no jig",
    "plan free --sensor sca3000-d01 --jig 0.3": "use no jig",
    f"measure level {SCA100T}": "level needs --base",
    f"measure level {SCA100T} --base absent.yaml": "absent.yaml: no such file",
    f"measure plane {SCA100T} --base {FIXTURES}/complete.yaml": "plane needs no --base",
    f"measure plane {SCA100T} --alignment 1": "--alignment is of readings that are angles, and",
    f"measure mounting {SCA100T}": "--base",
    f"measure mounting {SCA100T} --base {FIXTURES}/plane.yaml": "plane.yaml is of SIM-42",
    f"measure plane {SCA100T} -o /proc/x.yaml --journal x.jsonl": "/proc/x.yaml",
    f"measure plane {SCA100T} -o there/x.yaml": "no folder",
    f"measure zero-45 {SCA100T} --sensor sca100t-d01 --tilt 45": "outside the range of sca100t-d01",
    "measure --resume no.journal.jsonl": "no.journal.jsonl: no such journal",
}


@pytest.mark.parametrize("command", REFUSED)
def test_refused_before_anyone_starts(command: str, tmp_path: Path) -> None:
    done = tiltcal(*command.split(), cwd=tmp_path, code=2)
    assert REFUSED[command] in done.stderr
    assert list(tmp_path.iterdir()) == []


BENCH = "tiltcal: 1\nkind: bench\njig: 0.01\nsensors:\n"
WRONG_BENCH = [
    (BENCH.rstrip() + " []\n", 4, "a list of at least 1"),
    (BENCH + '  - {serial: A, model: m, adress: "sim:"}\n', 5, "'address'"),
    (BENCH + '  - {serial: a/b, model: m, address: "sim:"}\n', 5, "names a file"),
    (BENCH + '  - {serial: A, model: sca100t-d02, address: "sim:", axes: [x, x]}\n', 5, "two or three"),
    (BENCH + '  - {serial: A, model: sca100t-d02, address: "sim:"}\nsensors: []\n', 6, "sensors"),
    (
        BENCH
        + '  - {serial: A, model: sca3000-e02, address: "sim:"}\nthermometer: {model: sca3000-e02, address: "sim:"}\n',
        6,
        "sca3000-e02 reports no temperature: it cannot be the bench's thermometer",
    ),
    (BENCH.replace("0.01", "-1") + '  - {serial: A, model: m, address: "sim:"}\n', 3, "jig"),
]


@pytest.mark.parametrize(("text", "line", "told"), WRONG_BENCH)
def test_a_wrong_bench_file(text: str, line: int, told: str, tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text(text)
    result = tiltcal("measure", "plane", "--bench", "bench.yaml", "--operator", "sim", cwd=tmp_path, code=2)
    assert f"bench.yaml:{line}: " in result.stderr
    assert told in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["bench.yaml"]


def test_a_plan_says_what_hand_held_positions_will_give() -> None:
    """Eighteen directions spread over the sphere, noise of one mean s: the bound of an independent ellipsoid fit."""
    result = tiltcal("plan", "free", "--sensor", "sca3000-d01", "--noise", "1.0", "--samples", "100", "--json", code=0)
    told = json.loads(result.stdout)
    predicted = told["uncertainty"]
    gravity = np.array([position.gravity for position in find_procedure("free").positions])
    # |u - offset| = S on a sphere: d length = -g . d offset - sum of g_i² d S_ii - ... for each direction.
    rows = np.hstack([gravity, *(gravity[:, [i]] * gravity[:, i:] for i in range(3))])
    covariance = 0.1**2 * np.linalg.inv(rows.T @ rows)
    for place, name in enumerate(("offset.x", "offset.y", "offset.z", "sensitivity.x.x", "sensitivity.x.y")):
        assert predicted[name] == pytest.approx(np.sqrt(covariance[place, place]), rel=0.02), name
    assert told["degrees_of_freedom"] == 9
    said = tiltcal("plan", "free", "--sensor", "sca3000-d01").stdout
    assert re.findall(r"  (\w+\.[.xyz]+) ", said) == [name for name, u in predicted.items() if u]
