"""Four bare import names must be ours: another distribution that installs one of them would be mixed in silently."""

from __future__ import annotations

import importlib
import importlib.metadata
from pathlib import Path

PACKAGES = ("agent", "mapping", "swarm", "transport")


def test_all_four_packages_come_from_one_place():
    folders = {Path(importlib.import_module(name).__file__).parent.parent for name in PACKAGES}
    assert len(folders) == 1


def test_no_other_distribution_owns_a_package_of_ours():
    owners = importlib.metadata.packages_distributions()
    assert {owner for name in PACKAGES for owner in owners.get(name, [])} <= {"orion-swarm"}


def test_each_package_is_typed():
    for name in PACKAGES:
        assert (Path(importlib.import_module(name).__file__).parent / "py.typed").is_file()
