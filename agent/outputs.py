"""What is kept and shown of a run, besides the maps in its folder: what an observer is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agent.page_options import PageOptions


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where what an observer comes to know goes; None is nowhere.

    Attributes:
        page: how it is shown live.
        record: a new file for the log (``agent.recorder``).
        scans: an npz for the scans that came by (``agent.scan_record``).
        state: the folder where it is remembered (``agent.keeper``).
        ros2: the endpoint of ROS 2's router (``agent.ros2``).
    """

    page: PageOptions | None = None
    record: Path | None = None
    scans: Path | None = None
    state: Path | None = None
    ros2: str | None = None

    def arguments(self) -> list[str]:
        """The options of ``orion observe`` that say the same, in whatever folder it is started."""
        files = {"--record": self.record, "--scans": self.scans, "--state": self.state}
        words = ["--no-page"] if self.page is None else self.page.arguments()
        words += [word for name, file in files.items() if file is not None for word in (name, str(file.absolute()))]
        return words + ([] if self.ros2 is None else ["--ros2", "--ros2-router", self.ros2])
