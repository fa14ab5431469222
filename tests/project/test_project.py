"""The house keeps its rules: packaging, start-up, help, errors, text."""

import re
import runpy
import shutil
import subprocess
import tomllib
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from support import ROOT
from support.command import loaded_by

import tiltcal
from tiltcal import errors
from tiltcal.cli.main import COMMANDS, GROUPS, group

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

HEAVY = {"numpy", "scipy", "polars", "narwhals", "rich", "matplotlib", "jinja2", "yaml", "spidev", "distributed"}
REGISTRIES = ("pypi" + ".org", "python" + "hosted.org", "anaconda" + ".org", "npmjs" + ".com", "crates" + ".io")


def tracked_files() -> list[Path]:
    """Every file that is in git or would be added to it."""
    git = shutil.which("git")
    if git is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listed = subprocess.run(
        [git, "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return [path for name in listed.stdout.split("\0") if name and (path := ROOT / name).is_file()]


# Packaging


def test_the_version_is_written_once() -> None:
    assert PROJECT["project"]["dynamic"] == ["readme", "version"]
    assert PROJECT["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "tiltcal.__version__"}
    assert CliRunner().invoke(group, ["--version"]).output == f"tiltcal, version {tiltcal.__version__}\n"
    assert f"\nversion: {tiltcal.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_constraints_are_exact_versions_of_all_that_is_required() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", pin) for pin in pins)
    pinned = {normal(pin.partition("==")[0]) for pin in pins}
    groups = PROJECT["project"]["optional-dependencies"].values()
    required = [*PROJECT["project"]["dependencies"], *(one for group in groups for one in group)]
    wanted = {normal(re.split(r"[<>=!~;\[ ]", one)[0]) for one in required} - {"tiltcal"}
    assert wanted <= pinned


def normal(name: str) -> str:
    """A distribution's name as the installers compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


# Start-up


def test_help_loads_nothing_heavy() -> None:
    loaded = loaded_by("from tiltcal.cli.main import run\nrun(['--help'])")
    assert "click" in loaded
    assert not loaded & HEAVY


def test_a_command_loads_what_it_needs(tmp_path: Path) -> None:
    shutil.copy(ROOT / "fixtures" / "complete.yaml", tmp_path / "S.yaml")
    (tmp_path / "log.csv").write_text("time,x,y,temperature\n0.0,1024,1022,20.5\n0.1,1030,1019,20.5\n")
    for command, needed in (
        ("devices", {"yaml"}),  # of the devices by their manual
        ("check S.yaml", {"numpy", "yaml"}),
        ("diff S.yaml S.yaml", {"numpy", "yaml", "scipy"}),  # for Student's t
        ("plan plane --sensor sca100t-d02 --jig 0.1", {"numpy", "yaml"}),
        ("apply S.yaml log.csv --uncertainty -o tilt.csv", {"numpy", "polars", "yaml"}),
    ):
        called = f"os.chdir({str(tmp_path)!r})\nassert run({command.split()}) == 0"
        loaded = loaded_by(f"import os\nfrom tiltcal.cli.main import run\n{called}")
        assert loaded & HEAVY == needed, command


WITHOUT = """
import io, os, select, signal, socket, subprocess, sys, time
import click, msgspec, numpy, polars, rich.console, scipy.optimize, scipy.stats, yaml
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in MODULES:
            raise ImportError(name)
MODULES = "fcntl grp posix pty pwd resource spidev smbus2 gpiod syslog termios tty".split()
sys.meta_path.insert(0, Missing())
for name in MODULES:
    sys.modules.pop(name, None)
NAMES = {
    os: "chflags chown chroot confstr copy_file_range ctermid environb eventfd fchdir fchmod fchown fdatasync fork "
    "forkpty fpathconf fstatvfs fwalk get_blocking getegid getenvb geteuid getgid getgrouplist getgroups "
    "getloadavg getpgid getpgrp getpriority getrandom getresgid getresuid getsid getuid getxattr initgroups "
    "killpg lchown listxattr lockf login_tty major makedev memfd_create minor mkfifo mknod nice openpty pathconf "
    "pidfd_open pipe2 posix_fadvise posix_fallocate posix_openpt posix_spawn posix_spawnp pread preadv pwrite "
    "pwritev readv register_at_fork removexattr sched_getaffinity sched_setaffinity sched_yield sendfile "
    "set_blocking setegid seteuid setgid setgroups setpgid setpriority setregid setresgid setresuid setreuid "
    "setsid setuid setxattr splice statvfs sync sysconf tcgetpgrp tcsetpgrp ttyname uname unshare wait wait3 "
    "wait4 waitid writev O_ASYNC O_CLOEXEC O_DIRECT O_DIRECTORY O_DSYNC O_NDELAY O_NOATIME O_NOCTTY O_NOFOLLOW "
    "O_NONBLOCK O_PATH O_RSYNC O_SYNC O_TMPFILE POSIX_FADV_DONTNEED",
    signal: "SIGALRM SIGBUS SIGCHLD SIGCONT SIGHUP SIGKILL SIGPIPE SIGQUIT SIGSTOP SIGTSTP SIGUSR1 SIGUSR2 SIGWINCH "
    "ITIMER_REAL alarm getitimer pause pthread_kill pthread_sigmask setitimer siginterrupt sigpending "
    "sigtimedwait sigwait",
    select: "epoll poll", socket: "AF_UNIX recv_fds send_fds sethostname", time: "clock_gettime clock_settime tzset",
}
for module, names in NAMES.items():
    for name in names.split():
        module.__dict__.pop(name, None)
only_sockets = select.select
def refuse(*waits):
    if not all(isinstance(one, socket.socket) for wait in waits[:3] for one in wait):
        raise OSError("not a socket")
    return only_sockets(*waits)
select.select = refuse
def symlink(*names, **options):
    raise OSError("a required privilege is not held")
os.symlink = symlink
def said(*lines):
    reading, writing = os.pipe()
    with open(writing, "w") as pipe:
        pipe.writelines(line + chr(10) for line in lines)
    sys.stdin = open(reading)
"""
"""What Windows does not have by Python's documentation, taken away: SPI, I2C and GPIO are Linux's."""


def test_a_session_stops_and_goes_on_without_what_windows_lacks(tmp_path: Path) -> None:
    session = "measure plane --sensor sca100t-d02 --address sim:seed=1 --serial S-1 --samples 20 -o S-1.yaml"
    ready, quits, journal = '{"answer": "ready"}', '{"answer": "quit"}', "S-1.journal.jsonl"
    loaded_by(
        f"{WITHOUT}\nimport pkgutil, importlib, tiltcal\n"
        "for one in pkgutil.walk_packages(tiltcal.__path__, 'tiltcal.'):\n"
        "    one.name.endswith('__main__') or importlib.import_module(one.name)\n"
        f"os.chdir({str(tmp_path)!r})\nfrom tiltcal.cli.main import run\n"
        f"said({ready!r}, {ready!r}, {quits!r})\nassert run({[*session.split(), '--operator', 'json']}) == 130\n"
        f"said({ready!r}, {ready!r})\nassert run(['measure', '--resume', {journal!r}, '--operator', 'json']) == 0\n"
        f"assert run(['check', 'S-1.yaml', {journal!r}]) == run(['replay', {journal!r}, '--golden', 'S-1.yaml']) == 0\n"
        f"assert run('record --sensor sca100t-d02 --address sim: --rows 3 -o log.csv'.split()) == 0\n"
        "said('x,y,temperature', '1024,1024,20', '1024,1025,20')\n"
        "assert run('apply S-1.yaml - -o tilt.csv'.split()) == 0"
    )


# Help


def test_every_command_has_help_with_an_example_and_every_option_has_help() -> None:
    """That of `apply` in 60 lines of a terminal 80 characters wide."""
    for command in COMMANDS:
        result = CliRunner().invoke(group, [command, "--help"], prog_name="tiltcal", terminal_width=78)
        assert result.exit_code == 0
        assert f"Usage: tiltcal {command}" in result.output
        assert re.search(rf"Examples?:\s+tiltcal\s+{command}\b", result.output)
        assert command != "apply" or result.output.count("\n") <= 60
        known = group.get_command(group.make_context("tiltcal", [command]), command)
        assert known is not None
        for parameter in known.params:
            assert parameter.param_type_name != "option" or getattr(parameter, "help", None), parameter.name


def test_tiltcal_alone_shows_three_ways_to_begin_and_then_the_list() -> None:
    shown = CliRunner().invoke(group, [], prog_name="tiltcal")
    ways, _, listed = shown.output.partition("\n\nUsage: tiltcal")
    begun = re.findall(r"tiltcal (\w+ .*)", ways)
    assert begun == ["probe --address serial:///dev/ttyUSB0", "probe LOG.csv", "demo demo"]
    assert shown.exit_code == 2
    assert re.findall(r"^Commands .*:$", listed, re.M) == [f"{title}:" for title in GROUPS]


def test_every_command_has_a_man_page_with_all_its_options(tmp_path: Path) -> None:
    runpy.run_path(str(ROOT / "docs" / "reference" / "man.py"))["main"](tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"tiltcal.1", *(f"tiltcal-{name}.1" for name in COMMANDS)}
    for name, line in COMMANDS.items():
        path = tmp_path / f"tiltcal-{name}.1"
        text = path.read_text(encoding="utf-8")
        assert f".SH NAME\ntiltcal-{name} \\- {line}\n" in text
        known = group.get_command(click.Context(group), name)
        assert known is not None
        options = {flag for one in known.params if isinstance(one, click.Option) for flag in one.opts}
        assert [flag for flag in options if flag.replace("-", "\\-") not in text] == []
        if groff := shutil.which("groff"):
            done = subprocess.run([groff, "-Kutf8", "-man", "-ww", "-Tutf8", path], capture_output=True, check=False)
            assert (done.returncode, done.stderr) == (0, b""), name


def test_every_command_module_is_a_command() -> None:
    modules = (ROOT / "tiltcal" / "cli").glob("*.py")
    commands = {path.stem for path in modules if "@options.command(" in path.read_text(encoding="utf-8")}
    assert commands == set(COMMANDS)


# Errors


def test_the_drawn_tree_of_errors_is_the_tree() -> None:
    drawn = re.findall(r"^ {4}[ │├└─]*([A-Z]\w+)(?: +exit (\d+))?", errors.__doc__ or "", re.MULTILINE)
    known = {name: one for name, one in vars(errors).items() if isinstance(one, type) and issubclass(one, Exception)}
    assert sorted(name for name, _ in drawn) == sorted(known)
    for name, code in drawn:
        assert not code or known[name].exit_code == int(code)


# Text


def test_no_file_names_a_package_registry() -> None:
    for path in tracked_files():
        content = path.read_bytes()
        assert not [host for host in REGISTRIES if host.encode() in content], path


def test_public_modules_say_what_they_are() -> None:
    for path in [*ROOT.glob("tiltcal/**/*.py"), *ROOT.glob("drivers/**/*.py"), *ROOT.glob("procedures/*.py")]:
        assert re.match(r'\s*r?"""\S', path.read_text(encoding="utf-8")), f"{path} has no docstring"
