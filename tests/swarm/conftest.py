"""What the swarm's tests share: the plain client, and properties that have time on a busy machine."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import settings

settings.register_profile("swarm", deadline=None, max_examples=30)
settings.load_profile("swarm")


@pytest.fixture(scope="session")
def plain_client() -> ModuleType:
    """The follower in plain Python beside this file."""
    path = Path(__file__).with_name("plain_client.py")
    spec = importlib.util.spec_from_file_location("plain_client", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["plain_client"] = module  # where dataclasses look for it
    spec.loader.exec_module(module)
    return module
