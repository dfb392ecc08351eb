"""What all tests share: where the real recordings are, and a loud word when there are none."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("orion", deadline=None)  # machines are shared: a slow example is no failure
settings.load_profile("orion")

_HOW = "set ORION_DATA to the folder that holds carmen/ and nano_swarm/"


@pytest.fixture(scope="session")
def recordings_dir() -> Path:
    """The folder of real recordings, named by ORION_DATA; without that the test is skipped, and the summary says so."""
    name = os.environ.get("ORION_DATA")
    if not name:
        pytest.skip(f"no real recordings: {_HOW}")
    folder = Path(name)
    if not folder.is_dir():
        pytest.fail(f"ORION_DATA={name} is no folder: {_HOW}")
    return folder


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """A line each on the tests that did not run for want of recordings, of a browser or of systemd."""
    skipped = [report for report in terminalreporter.getreports("skipped") if "recordings" in report.keywords]
    if skipped:
        terminalreporter.write_line(f"{len(skipped)} recordings tests were SKIPPED: {_HOW}", yellow=True, bold=True)
    unseen = [report for report in terminalreporter.getreports("skipped") if "browser" in report.keywords]
    if unseen:
        how = "install chromium and chromium-driver, and build web/"
        terminalreporter.write_line(f"{len(unseen)} browser tests were SKIPPED: {how}", yellow=True, bold=True)
    unverified = [report for report in terminalreporter.getreports("skipped") if "units" in report.keywords]
    if unverified:
        how = "apt-get install systemd"
        terminalreporter.write_line(f"{len(unverified)} units tests were SKIPPED: {how}", yellow=True, bold=True)
