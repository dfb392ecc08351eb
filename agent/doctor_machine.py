"""What ``orion doctor`` asks a machine: its packages, kernels, clock, disk, rights and network ports.

Each check is a function that gives findings and changes nothing.
"""

from __future__ import annotations

import ctypes
import errno
import getpass
import grp
import importlib.metadata
import importlib.util
import os
import shutil
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

from packaging.requirements import Requirement

from agent.finding import Finding, ok, problem, warning
from agent.links import bind_once

DISTRIBUTION = "orion-swarm"
PACKAGES = ("agent", "mapping", "swarm", "transport")

_LITTLE_DISK, _NO_DISK = 1 << 30, 50 << 20
"""Bytes: below the first a recording of a day may not fit, below the second a large map may not."""

_NOT_SYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)
_TIMEX_BYTES = 512  # struct timex is 208 bytes on 64-bit Linux


def machine(folder: Path) -> Iterator[Finding]:
    """All that concerns the machine and no swarm in particular.

    Args:
        folder: where files are going to be written.
    """
    yield from own_packages()
    yield from packages(requirements())
    yield cosine_table()
    yield kernel_cache()
    yield clock()
    yield disk(folder)
    yield serial_rights()
    yield ok("multicast", "not needed: peers find each other by the configuration's hosts")


def requirements() -> list[Requirement]:
    """What the project needs: as the checkout's project file says, or as it was installed."""
    file = Path(__file__).parent.parent / "pyproject.toml"
    if file.is_file():
        project = tomllib.loads(file.read_text())["project"]
        extras = project["optional-dependencies"].items()
        of_extras = [f"{line}; extra == '{extra}'" for extra, lines in extras for line in lines]
        return [Requirement(line) for line in [*project["dependencies"], *of_extras]]
    try:
        return [Requirement(line) for line in importlib.metadata.requires(DISTRIBUTION) or []]
    except importlib.metadata.PackageNotFoundError:
        return []


def own_packages() -> Iterator[Finding]:
    """Whether our four packages are ours alone: pip overwrites a package of the same name without a word."""
    specs = [importlib.util.find_spec(name) for name in PACKAGES]
    folders = {str(Path(spec.origin).parent.parent) for spec in specs if spec is not None and spec.origin is not None}
    owners = importlib.metadata.packages_distributions()
    strangers = sorted({owner for name in PACKAGES for owner in owners.get(name, [])} - {DISTRIBUTION})
    if strangers:
        remedy = f"pip uninstall {' '.join(strangers)}, or give orion a virtual environment of its own"
        yield problem("orion", f"packages of the same names were installed by {', '.join(strangers)}", remedy)
    elif len(folders) != 1:
        remedy = "start orion in another folder, or unset PYTHONPATH"
        yield problem("orion", f"its packages come from {' and '.join(sorted(folders))}", remedy)
    else:
        yield ok("orion", f"{_version(DISTRIBUTION) or 'a checkout, not installed,'} in {folders.pop()}")


def packages(needed: list[Requirement]) -> Iterator[Finding]:
    """Whether the packages are there, in versions that we know: one finding for those, one for each that is not."""
    if not needed:
        yield warning("packages", "it is not known which are needed", f"pip install {DISTRIBUTION}")
        return
    good, absent = [], []
    for requirement in needed:
        extra = _extra(requirement)
        if extra == "test" or (extra is None and requirement.marker and not requirement.marker.evaluate()):
            continue
        version = _version(requirement.name)
        if version is None and extra is not None:
            absent.append(f"{requirement.name} (extra {extra})")
        elif version is None:
            yield problem("packages", f"{requirement.name} is missing", f"pip install '{_plain(requirement)}'")
        elif not requirement.specifier.contains(version, prereleases=True):
            grade = problem if extra is None else warning
            remedy = f"pip install '{_plain(requirement)}'"
            yield grade("packages", f"{requirement.name} is {version}, expected {requirement.specifier}", remedy)
        else:
            good.append(f"{requirement.name} {version}")
    yield ok("packages", ", ".join(good) or "none")
    if absent:
        yield ok("extras", f"not installed, needed only for what they are named after: {', '.join(absent)}")


def cosine_table() -> Finding:
    """Whether this machine draws the same rays as everybody else."""
    try:
        from mapping.cosine import TABLE_SHA256
    except RuntimeError as error:
        return problem("cosine table", str(error), "use another build of Python and NumPy")
    return ok("cosine table", f"SHA-256 {TABLE_SHA256[:16]}..., as everywhere")


def kernel_cache() -> Finding:
    """Whether the compiled kernels lie in numba's cache."""
    subject = "kernels"
    if importlib.util.find_spec("numba") is None:
        remedy = f"pip install '{DISTRIBUTION}[fast]', if this computer is to map a lot"
        return ok(subject, f"NumPy's: the same maps, slower; {remedy}")
    try:
        from mapping import raster_jit
    except ImportError as error:
        return warning(subject, f"numba is installed and does not work: {error}", "pip install --upgrade numba")
    paths = {str(it.stats.cache_path) for it in vars(raster_jit).values() if hasattr(it, "stats")}
    cached = [file for path in paths for file in Path(path).glob("raster_jit.*.nbi")]
    if cached:
        return ok(subject, f"compiled ones, in {cached[0].parent}")
    return ok(subject, f"compiled ones, not compiled yet: the first run does so, in {' '.join(sorted(paths))}")


def clock(now: Callable[[], float] = time.time, synchronised: Callable[[], bool | None] | None = None) -> Finding:
    """Whether the clock can be right. Maps do not need it; stamps in logs, and robots that know no time, do.

    Args:
        now: the clock, seconds since 1970.
        synchronised: whether the kernel is told the time by somebody; None is not known.
    """
    remedy = "switch network time on: timedatectl set-ntp true"
    if now() < Path(__file__).stat().st_mtime - 86_400:
        return warning("clock", "it is earlier than this program is old", remedy)
    match (_kernel_is_told_the_time if synchronised is None else synchronised)():
        case True:
            return ok("clock", "synchronised")
        case False:
            return warning("clock", "not synchronised: the stamps of this robot are its own", remedy)
        case None:
            return ok("clock", "can be right; this system does not tell whether it is synchronised")


def disk(folder: Path, free: Callable[[Path], int] = lambda path: shutil.disk_usage(path).free) -> Finding:
    """Whether files have room."""
    room = free(folder)
    found = f"{room / (1 << 30):.1f} GiB free in {folder}"
    if room >= _LITTLE_DISK:
        return ok("disk", found)
    return (problem if room < _NO_DISK else warning)("disk", found, "delete something, or work in another folder")


def serial_rights() -> Finding:
    """Whether this user may open serial devices."""
    if os.geteuid() == 0:
        return ok("serial rights", "root may open every device")
    groups = {}
    for name in ("dialout", "uucp"):  # Debian's and Fedora's name, Arch's
        try:
            groups[name] = grp.getgrnam(name)
        except KeyError:
            continue
    if any(group.gr_gid in {*os.getgroups(), os.getegid()} for group in groups.values()):
        return ok("serial rights", f"in the group {' '.join(groups)}")
    if not groups:
        return ok("serial rights", "this system has no group for serial devices")
    name, group = next(iter(groups.items()))
    if getpass.getuser() in group.gr_mem:
        return warning("serial rights", f"in the group {name}, but not yet in this session", "log out and in again")
    remedy = f"sudo usermod -aG {name} $USER, then log in again; only a robot on a device needs it"
    return warning("serial rights", f"not in the group {name}", remedy)


def network_port(robot: str, host: str, port: int) -> tuple[bool, Finding]:
    """Whether a robot could listen: and whether it lives on this machine at all.

    Args:
        robot: its id.
        host: where it lives.
        port: where it is going to listen.
    """
    subject = f"{robot} {host}:{port}"
    try:
        bind_once(host, port)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        if error.errno == errno.EADDRINUSE:
            return True, problem(subject, "is occupied", "end what listens there, or give another base_port")
        if error.errno == errno.EADDRNOTAVAIL:
            return False, ok(subject, "is another machine's")
        if isinstance(error, PermissionError):
            return True, problem(subject, reason, "give a base_port of 1024 or more")
        return False, problem(subject, reason, "mend the robot's host, or the network's names")
    except UnicodeError as error:
        return False, problem(subject, str(error), "mend the robot's host")
    return True, ok(subject, "is free")


def _kernel_is_told_the_time() -> bool | None:
    try:
        state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))  # modes 0: only asks
    except (AttributeError, OSError):
        return None
    return None if state < 0 else state != _NOT_SYNCHRONISED


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _extra(requirement: Requirement) -> str | None:
    """Which extra asks for it; None is that everybody needs it."""
    text = str(requirement.marker or "").replace('"', "'")
    return text.partition("extra == '")[2].partition("'")[0] or None


def _plain(requirement: Requirement) -> str:
    return f"{requirement.name}{requirement.specifier}"
