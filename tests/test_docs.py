"""The documentation is true: its reference is that of the program, its links lead somewhere, it builds."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import types
import typing
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

import docs_reference
from agent import config
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.map_server import encode_map_server, free

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TEXTS = [*sorted(ROOT.glob("*.md")), *PAGES]


def test_the_commands_page_is_what_the_commands_say_of_themselves() -> None:
    assert (DOCS / "commands.md").read_text() == docs_reference.page(), "run: python docs_reference.py"


# The configuration's keys

TABLES: dict[str, type[BaseModel]] = {
    "Swarm": config.Config,
    "Robots": config.Robot,
    "Start": config.Start,
    "Serial body": config.SerialBody,
    "Recorded body": config.RecordedBody,
    "Log body": config.LogBody,
    "Observers": config.Station,
    "Evidence": config.Evidence,
    "Orion sensor": config.OrionSensor,
    "Laser sensor": config.LaserSensor,
    "Beams sensor": config.BeamsSensor,
    "Beam": config.BeamTable,
    "Simulation": config.Simulation,
    "Noise": config.SimulatedNoise,
}


def told_keys(heading: str) -> dict[str, str]:
    """What the page says under a heading: defaults by key."""
    text = (DOCS / "configuration.md").read_text()
    (section,) = re.findall(rf"^#+ {heading}\n(.*?)(?=^#|\Z)", text, re.DOTALL | re.MULTILINE)
    return dict(re.findall(r"^\| `(\w+)` \| (.*?) ?\|", section, re.MULTILINE))


@pytest.mark.parametrize("heading", TABLES)
def test_every_key_of_the_configuration_is_told_with_its_default(heading: str) -> None:
    told, fields = told_keys(heading), TABLES[heading].model_fields
    assert list(told) == list(fields)
    for key, field in fields.items():
        default = field.get_default(call_default_factory=True)
        if default is PydanticUndefined:
            assert told[key] == "", key
        elif default is None:
            assert told[key] == "none", key
        elif isinstance(default, BaseModel):
            assert told[key] == "see there", key
        else:
            assert tomllib.loads(f"value = {told[key].strip('`')}")["value"] == default, key


def models(of: object) -> set[type[BaseModel]]:
    """All tables that a type is made of."""
    if isinstance(of, type) and not isinstance(of, types.GenericAlias) and issubclass(of, BaseModel):
        return {of}.union(*(models(field.annotation) for field in of.model_fields.values()))
    return set().union(*(models(each) for each in typing.get_args(of)))


def test_no_table_of_the_configuration_is_left_out() -> None:
    assert set(TABLES.values()) == models(config.Config)


# Map files

same_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=5)


@same_folder
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 40), columns=st.integers(1, 40))
def test_the_documented_program_finds_in_our_files_what_is_free_occupied_and_unknown(
    tmp_path: Path, seed: int, rows: int, columns: int
) -> None:
    dice = np.random.default_rng(seed)
    evidence = dice.integers(-400, 400, (rows, columns), dtype=np.int32)
    evidence[dice.random((rows, columns)) < 0.3] = 0
    picture, description = encode_map_server(Grid(evidence, 3, -7, Lattice(50)), "map.pgm")
    (tmp_path / "map.pgm").write_bytes(picture)
    (tmp_path / "map.yaml").write_bytes(description)
    programs = re.findall(r"```python\n(.*?)```", (DOCS / "maps.md").read_text(), re.DOTALL)
    (program,) = (each for each in programs if "yaml" in each)
    words = [sys.executable, "-c", program, "map.yaml", "map.pgm"]
    told = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.split()
    occupied = int(np.count_nonzero(evidence > 61))
    frees = int(np.count_nonzero(free(evidence)))
    assert [int(number) for number in told[::2]] == [occupied, frees, evidence.size - occupied - frees]


# Links


def prose(path: Path) -> str:
    """A text without what is code."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^```.*?^```$", "", path.read_text(), flags=re.DOTALL | re.MULTILINE))


def anchors(path: Path) -> set[str]:
    """Where one can jump to in a text."""
    text = re.sub(r"^```.*?^```$", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(path: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(path)):
        url = urlsplit(link)
        if url.scheme:
            assert url.scheme in {"http", "https"}
            continue
        target = (path.parent / url.path).resolve() if url.path else path
        assert target.is_file(), link
        assert path not in PAGES or target.is_relative_to(DOCS), f"{link} is not on the site"
        assert not url.fragment or url.fragment in anchors(target), link


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_page_is_in_the_sites_contents(path: Path) -> None:
    assert f'"{path.relative_to(DOCS)}"' in (ROOT / "zensical.toml").read_text()


# The site


class Asked(HTMLParser):
    """What a browser asks for when it is shown a page."""

    def __init__(self) -> None:
        super().__init__()
        self.urls: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if value and (name == "src" or (name == "href" and tag == "link")):
                self.urls.append(value)


def test_the_site_builds_strictly_says_what_the_readme_says_and_asks_nothing_of_others(tmp_path: Path) -> None:
    for name in ("README.md", "zensical.toml"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(DOCS, tmp_path / "docs")
    words = [sys.executable, "-m", "zensical", "build", "--strict"]
    done = subprocess.run(
        words,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=os.environ | {"NO_COLOR": "1"},
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    built = sorted((tmp_path / "site").rglob("*.html"))
    assert len(built) == len(PAGES) + 1, "all pages, and one for those that are not there"
    for page in built:
        text = page.read_text()
        assert "--8&lt;--" not in text
        assert "--8<--" not in text
        asked = Asked()
        asked.feed(text)
        assert asked.urls
        assert [url for url in asked.urls if urlsplit(url).netloc] == []
    assert "log-odds evidence" in (tmp_path / "site" / "index.html").read_text()
