"""``python -m benchmarks [NAME...]``: measures, prints a table with ratios, and writes it as JSON."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import sys
from pathlib import Path

from benchmarks.table import printed

NAMES = {
    "integration": "scans into a map: both kernels, MRPT and OctoMap, on recorded logs",
    "five_beams": "one scan of an Orion into evidence, one call",
    "fusion": "summing robots' maps, and what an update costs as robots and maps grow",
    "updates": "scans into bytes and back",
    "agents": "real agent processes over Zenoh: latency, computing, memory",
    "late": "a peer that comes late and fetches everything over Zenoh",
    "wire": "bytes that a run sends, against full grids and single laser scans",
    "rules": "ways to merge maps, on the same noisy data",
    "page": "the observer's page with a map of 6,400 tiles, in Chromium",
    "page_memory": "the page's server for a minute: 20 robots, a browser, and one that never reads",
    "log_jumps": "a recorded run on the page: reading it, jumping in it",
    "many": "peers in one process under fake time",
}


def main() -> int:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        epilog="\n".join(f"{name:12} {what}" for name, what in NAMES.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="default: all of them")
    parser.add_argument("--json", type=Path, default=Path("benchmarks.json"), metavar="FILE")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - NAMES.keys():
        parser.error(f"no such benchmark: {', '.join(sorted(unknown))}")
    machine = {"machine": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
    tables: dict[str, object] = {}
    for name in arguments.names or NAMES:
        load = os.getloadavg()[0]
        rows = importlib.import_module(f"benchmarks.{name}").measure()
        sys.stdout.write(printed(f"{name}: {NAMES[name]} (load {load:.1f})", rows) + "\n\n")
        sys.stdout.flush()
        tables[name] = {"load": load, "rows": [row._asdict() for row in rows]}
        arguments.json.write_text(json.dumps(machine | {"benchmarks": tables}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
