"""Finding a sensor model: built in, added by a third party, or not there."""

import subprocess
import sys
from pathlib import Path

import pytest

from tiltcal.drivers import find_model, models
from tiltcal.errors import UsageError

PLUGIN = """
from dataclasses import replace
from tiltcal.drivers.sca100t import D02
MODEL = replace(D02, name="acme-7")
NO_MODEL = 7
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Install a package with entry points for tiltcal into a folder that is on the path for this test."""
    monkeypatch.syspath_prepend(tmp_path)

    def install(package: str, entry_points: str, module: str = PLUGIN) -> None:
        name = package.replace("-", "_")
        (tmp_path / f"{name}.py").write_text(module)
        record = tmp_path / f"{name}-1.0.dist-info"
        record.mkdir()
        (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (record / "entry_points.txt").write_text(f"[tiltcal.devices]\n{entry_points}\n")
        monkeypatch.delitem(sys.modules, name, raising=False)

    return install


def test_models_carry_the_name_that_they_are_found_by_and_near_names_are_offered() -> None:
    names = [model.name for model in models()]
    assert names[:2] == ["sca100t-d01", "sca100t-d02"]
    assert [find_model(name).name for name in names] == names
    for name, advice in (
        ("sca100t", "did you mean 'sca100t-d02' or 'sca100t-d01'"),
        ("SCA100T-D01", "did you mean 'sca100t-d01'"),
        ("zzz", "'tiltcal devices' lists them"),
    ):
        with pytest.raises(UsageError, match=f"no sensor model is called '{name}'") as error:
            find_model(name)
        assert advice in str(error.value)
        assert str(error.value).endswith("is it of a package that is not installed here?")


def test_a_name_has_one_package(install) -> None:
    install("acme-sensors", "acme-7 = acme_sensors:MODEL")
    install("bcme-sensors", "acme-7 = bcme_sensors:MODEL")
    install("evil-sensors", "sca100t-d02 = evil_sensors:MODEL")
    with pytest.raises(UsageError, match="'acme-sensors' and 'bcme-sensors' both have a sensor model called 'acme-7'"):
        find_model("acme-7")
    with pytest.raises(UsageError, match="'tiltcal' and 'evil-sensors' both have a sensor model called 'sca100t-d02'"):
        find_model("sca100t-d02")
    assert find_model("sca100t-d01").name == "sca100t-d01"
    with pytest.raises(UsageError, match="did you mean 'acme-7'"):
        find_model("acme-8")


@pytest.mark.parametrize(
    ("entry", "module", "why"),
    [
        ("acme-7 = acme_sensors:MODEL", "import no_such_thing", "ModuleNotFoundError: No module named 'no_such_thing'"),
        ("acme-7 = acme_sensors:MODEL", "1 / 0", "ZeroDivisionError: division by zero"),
        ("acme-7 = acme_sensors:ABSENT", PLUGIN, "AttributeError"),
        ("acme-7 = acme_sensors:NO_MODEL", PLUGIN, "is a int, not a tiltcal.drivers.model.Model"),
        ("acme-7x = acme_sensors:MODEL", PLUGIN, "is named 'acme-7'"),
    ],
)
def test_a_broken_plug_in_is_named_with_its_cause(install, entry: str, module: str, why: str) -> None:
    install("acme-sensors", entry, module)
    with pytest.raises(UsageError) as error:
        find_model(entry.partition(" ")[0])
    message = str(error.value)
    assert "package 'acme-sensors'" in message
    assert "acme_sensors:" in message
    assert why in message


def test_looking_up_a_model_loads_nothing_heavy_and_no_driver_loads_numpy() -> None:
    program = (
        "import pkgutil, sys, importlib, tiltcal.drivers as d; d.find_model('sca100t-d02')\n"
        "heavy = {'numpy', 'spidev', 'yaml', 'statistics', 'tiltcal.drivers.parts'} & set(sys.modules)\n"
        "for module in pkgutil.walk_packages(d.__path__, 'tiltcal.drivers.'): importlib.import_module(module.name)\n"
        "print(sorted(heavy), 'numpy' in sys.modules, 'tiltcal.drivers.parts' in sys.modules)"
    )
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[] False True"
